"""The store: what is added is there, whole, whatever happens to who writes or to the disk."""

from __future__ import annotations

import os
import sqlite3
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

import menid_plan
from conftest import ROOT
from menid_plan.errors import MenidError
from menid_plan.experience import files, schema
from menid_plan.experience.record import DistributionKey, Experience, Explanation
from menid_plan.experience.store import Store, StoreError, StoreInputError
from menid_plan.grounding.state import GroundAction
from menid_plan.model.domain import Domain, Problem
from menid_plan.model.formulas import GroundAtom
from models import state

TEXT = """
domain lamp
type switch
environment room : target
environment model : test
environment sketch : test
predicate lit
predicate worn(switch)
predicate joined(switch, switch)
action press(s: switch) {
  rule dark per s {
    when not lit
    outcomes { on: 0.7 lit  wears: 0.3 worn(s) }
  }
}
action rest { rule any { outcomes { slept: 1 nothing } } }
problem evening for lamp
object left, right: switch
goal lit
"""

DARK = Explanation("dark", ("left",), (1.0, 0.0, 0.0))
LEFT = GroundAction("press", ("left",))


def parts(text: str = TEXT) -> tuple[Domain, Problem]:
    document = menid_plan.parse(text)
    assert document.domain is not None
    assert document.problem is not None
    return document.domain, document.problem


BOTH = parts()


def test_of(number: int, /, **changes: object) -> Experience:
    """Test ``number`` of pressing the left switch."""
    made = Experience(
        "model",
        state(),
        LEFT,
        state("lit"),
        None,
        0.25,
        1000 + number,
        1.7e9 + number,
        DARK,
        number,
    )
    return replace(made, **changes)  # type: ignore[arg-type]


test_of.__test__ = False  # type: ignore[attr-defined]


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / "run.store"


@pytest.fixture
def store(path: Path) -> Iterator[Store]:
    with Store.create(path, *BOTH, settings={"m": 10, "tests": ["model"]}, seed=2**70) as opened:
        yield opened


# ------------------------------------------------------------------------------- what goes in and out

ATOMS = [GroundAtom("lit"), GroundAtom("worn", ("left",)), GroundAtom("joined", ("left", "right"))]

states = st.frozensets(st.sampled_from(ATOMS))
weights = st.sampled_from([(1.0, 0.0, 0.0), (1 / 3, 2 / 3, 0.0), (0.1, 0.2, 0.7)])
finite = st.floats(allow_nan=False, allow_infinity=False)
explanations = st.one_of(
    st.none(),
    st.builds(Explanation, st.just("dark"), st.sampled_from([("left",), ("right",)]), weights),
)


@st.composite
def experiences(draw: st.DrawFn) -> list[Experience]:
    found = []
    counters: dict[object, int] = {}
    for _ in range(draw(st.integers(0, 12))):
        environment = draw(st.sampled_from(["room", "model", "sketch"]))
        action = draw(
            st.sampled_from([LEFT, GroundAction("press", ("right",)), GroundAction("rest")])
        )
        key = "room" if environment == "room" else (environment, action)
        number = counters[key] = counters.get(key, -1) + 1
        explanation = draw(explanations)
        if explanation is not None:
            values = action.arguments
            explanation = (
                replace(explanation, values=values)
                if values
                else Explanation("any", (), (1.0, 0.0))
            )
        found.append(Experience(
            environment, draw(states), action, draw(states), draw(st.one_of(st.none(), finite)),
            draw(st.floats(0, 1e300)), draw(st.integers()), draw(finite), explanation, number,
        ))  # fmt: skip
    return found


@settings(
    max_examples=30, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
@given(experiences(), st.integers(0, 12))
def test_what_is_added_is_read_back(
    tmp_path_factory: pytest.TempPathFactory, added: list[Experience], cut: int
) -> None:
    path = tmp_path_factory.mktemp("store") / "a.store"
    with Store.create(path, *BOTH) as store:
        assert store.add(added[:cut]) == len(added[:cut])
        assert list(store) == added[:cut]
    with Store.resume(path, *BOTH) as store:
        assert store.add(iter(added)) == len(added[cut:])  # the first are there already
        assert (list(store), len(store)) == (added, len(added))
        with Store.read(path) as reader:
            assert list(reader) == added
    with Store.read(path) as reader:
        assert list(reader) == added
        assert list(reader.unexplained()) == [e for e in added if e.explanation is None]
        sums: dict[tuple[str, DistributionKey], list[float]] = {}
        for seen in added:
            if seen.explanation is not None:
                weights = seen.explanation.weights
                key = (seen.environment, seen.explanation.key(seen.action))
                row = sums.setdefault(key, [0.0] * len(weights))
                for index, weight in enumerate(weights):
                    row[index] += weight
        assert reader.counts() == {key: tuple(row) for key, row in sums.items()}  # to the last bit
        for name, totals in reader.totals().items():
            here = [e for e in added if e.environment == name]
            assert totals.executions == len(here)
            assert totals.seconds == sum(e.duration for e in here)
            assert totals.rewarded == sum(e.reward is not None for e in here)
            assert totals.unexplained == sum(e.explanation is None for e in here)
            noise = [e.explanation.weights[-1] for e in here if e.explanation]
            assert totals.noise == pytest.approx(sum(noise))
            assert totals.explained + totals.noise == pytest.approx(len(noise))
        assert reader.next_step() == sum(e.environment == "room" for e in added)
        tests = [(e.environment, e.action) for e in added if e.environment != "room"]
        assert reader.next_tests() == {key: tests.count(key) for key in tests}


def test_what_a_store_says_of_itself(store: Store, path: Path) -> None:
    with Store.read(path) as reader:
        assert (reader.domain, reader.problem) == BOTH
        assert reader.settings == {"m": 10, "tests": ["model"]}
        assert reader.seed == 2**70
        assert reader.created.endswith("+00:00")
        assert reader.roles == {"room": "target", "model": "test", "sketch": "test"}
        assert reader.counts() == {}
        assert reader.next_step() == 0
        assert reader.next_tests() == {}
        assert set(reader.totals()) == {"room", "model", "sketch"}


def test_many_batches_are_read_in_order(store: Store) -> None:
    for begin in range(0, 12_000, 4000):
        assert store.add(test_of(begin + i) for i in range(4000)) == 4000
    assert [e.number for e in store] == list(range(12_000))
    assert store.add(test_of(i) for i in range(11_990, 12_010)) == 10
    assert store.counts() == {
        ("model", DistributionKey("press", "dark", ("left",))): (12_010.0, 0.0, 0.0)
    }


def test_a_store_at_rest_is_one_file(path: Path) -> None:
    with Store.create(path, *BOTH) as store:
        store.add([test_of(0)])
        store.close()
    with Store.read(path) as reader:
        assert len(reader) == 1
    assert sorted(p.name for p in path.parent.iterdir()) == ["run.store", "run.store.lock"]


# ----------------------------------------------------------------------------------------- duplicates


def test_what_is_there_already_is_left_out(store: Store) -> None:
    assert store.add([test_of(0), test_of(1), test_of(0)]) == 2
    # A repeated execution may end at another time, and take another.
    assert store.add([test_of(1, when=5.0, duration=9.0), test_of(2)]) == 1
    assert [e.number for e in store] == [0, 1, 2]
    # The key of a test has the environment and the action; that of a step has neither.
    right = GroundAction("press", ("right",))
    others = [
        test_of(0, environment="sketch"),
        test_of(0, action=right),
        test_of(0, environment="room"),
    ]
    assert store.add(others) == 3
    with pytest.raises(StoreInputError, match="has step 0 in `room` already"):
        store.add([test_of(0, environment="room", action=right)])


@pytest.mark.parametrize("changes", [{"after": state()}, {"state": state("lit")}, {"seed": 1}])
def test_what_is_there_and_was_another_is_refused(store: Store, changes: dict[str, object]) -> None:
    store.add([test_of(0)])
    with pytest.raises(StoreInputError, match=r"test 0 of `press\(left\)` in `model` already"):
        store.add([test_of(1), test_of(0, **changes), test_of(2)])
    assert list(store) == [test_of(0)]  # the rest of the batch is not there either
    assert store.add([test_of(1)]) == 1


@pytest.mark.parametrize(
    "changes",
    [
        {"environment": "garden"},
        {"number": -1},
        {"duration": -1.0},
        {"duration": float("nan")},
        {"duration": float("inf")},
        {"when": float("nan")},
        {"reward": float("inf")},
    ],
)
def test_what_is_no_experience(store: Store, changes: dict[str, object]) -> None:
    with pytest.raises(ValueError, match=r"experience|environment"):
        store.add([test_of(0, state=state("worn left")), test_of(1, **changes)])
    assert len(store) == 0
    # The state of the batch that was not added is not taken for one that is in the file.
    added = [test_of(0, state=state("worn left"))]
    store.add(added)
    assert list(store) == added


# ---------------------------------------------------------------------------------- opening, and locks


def told(action: Callable[[], object]) -> MenidError:
    with pytest.raises(MenidError) as caught:
        action()
    return caught.value


def test_modes_of_opening(path: Path) -> None:
    error = told(lambda: Store.resume(path, *BOTH))
    assert (str(error), error.exit_code) == (f"there is no store `{path}`", 3)
    assert str(told(lambda: Store.read(path))) == f"there is no store `{path}`"
    assert not list(path.parent.iterdir())
    Store.create(path, *BOTH).close()
    error = told(lambda: Store.create(path, *BOTH))
    assert str(error) == f"there is a store `{path}` already; resume it, or give another name"
    with Store.create(path, *BOTH, resume=True) as store:
        store.add([test_of(0)])
    with Store.resume(path) as store:
        assert len(store) == 1
    with Store.read(path) as reader:
        error = told(lambda: reader.add([test_of(1)]))  # type: ignore[attr-defined]
        assert "reading only" in str(error)


def test_a_store_of_something_else(path: Path) -> None:
    Store.create(path, *BOTH).close()
    domain, problem = BOTH
    other = parts(TEXT.replace("0.7", "0.6").replace("0.3", "0.4"))[0]
    error = told(lambda: Store.resume(path, other, problem))
    assert str(error) == (
        f"`{path}` is a store of another domain: of `lamp`, not of this `lamp`; "
        "rule `press.dark` differs"
    )
    assert error.exit_code == 3
    night = parts(TEXT.replace("evening", "night"))[1]
    for make in (Store.resume, lambda *a: Store.create(*a, resume=True)):
        error = told(lambda m=make: m(path, domain, night))  # type: ignore[misc]
        assert "another problem: of `evening`, not of this `night`; the name differs" in str(error)
    Store.resume(path, *parts(TEXT.replace("type switch", "type   switch"))).close()


def test_comments_do_not_count(path: Path) -> None:
    Store.create(path, *BOTH).close()
    commented = TEXT.replace("predicate lit", "# It shines.\npredicate lit")
    commented = commented.replace("  rule dark", "  # Nobody sees a thing.\n  rule dark")
    commented = commented.replace("object left", "# Two.\nobject left")
    with Store.resume(path, *parts(commented)) as store:
        store.must_suit(*parts(commented))


@pytest.mark.parametrize(
    ("old", "new", "what"),
    [
        ("type switch", "type thing\ntype switch < thing", "type `switch` differs"),
        ("predicate lit", "predicate lit\npredicate hot", "predicate `hot` is not in the store's"),
        ("3 worn(s)", "3 lit", "rule `press.dark` differs"),
        ("slept:", "dozed:", "rule `rest.any` differs"),
        ("environment sketch : test", "", "environment `sketch` is in the store's only"),
        ("object left,", "object middle, left,", "object `middle` is not in the store's"),
        ("goal lit", "goal not lit", "the goal differs"),
    ],
)
def test_what_differs_is_told(path: Path, old: str, new: str, what: str) -> None:
    assert old in TEXT
    with Store.create(path, *BOTH) as store:
        other = parts(TEXT.replace(old, new))
        for refuse in (store.must_be_of, store.must_suit):
            assert str(told(lambda r=refuse: r(*other))).endswith(f"; {what}")  # type: ignore[misc]


def test_other_probabilities_suit_the_experiences(path: Path) -> None:
    other = parts(TEXT.replace("0.7", "0.6").replace("0.3", "0.4"))
    with Store.create(path, *BOTH) as store:
        store.must_suit(*other)
        told(lambda: store.must_be_of(*other))


def test_one_writer_and_readers(store: Store, path: Path) -> None:
    store.add([test_of(0)])
    message = f"another process writes to the store `{path}`; a store has one writer at a time"
    for again in (
        lambda: Store.resume(path, *BOTH),
        lambda: Store.create(path, *BOTH, resume=True),
    ):
        assert str(told(again)) == message
    with Store.read(path) as reader:
        assert len(reader) == 1
        store.add([test_of(1)])
        assert [e.number for e in reader] == [0, 1]
    program = (
        "import sys, menid_plan.experience.store as s\n"
        "with s.Store.read(sys.argv[1]) as reader: print(len(reader))\n"
        "try: s.Store.resume(sys.argv[1])\n"
        "except s.StoreError as error: print(error)\n"
    )
    said = subprocess.run(
        [sys.executable, "-c", program, path], capture_output=True, text=True, check=True, cwd=ROOT
    ).stdout.splitlines()
    assert said == ["2", message]
    store.close()
    Store.resume(path, *BOTH).close()


def test_an_empty_file_becomes_a_store(path: Path) -> None:
    path.touch()
    assert "no store of experiences" in str(told(lambda: Store.resume(path)))
    assert "no store of experiences" in str(told(lambda: Store.read(path)))
    Store.create(path, *BOTH).close()
    Store.read(path).close()


# ------------------------------------------------------------------------ what is no store, or damaged


@pytest.mark.parametrize("content", [b"domain lamp\n" * 50, b"\0" * 5000, b"SQLite format 3\0"])
def test_files_that_are_no_stores(path: Path, content: bytes) -> None:
    path.write_bytes(content)
    for use in (lambda: Store.read(path), lambda: Store.resume(path, *BOTH)):
        error = told(use)
        assert str(error) == f"`{path}` is no store of experiences"
        assert error.exit_code == 3
    told(lambda: Store.create(path, *BOTH))
    assert path.read_bytes() == content
    assert [p.name for p in path.parent.iterdir()] == ["run.store"]


def test_a_database_of_somebody_else(path: Path) -> None:
    connection = sqlite3.connect(path)
    connection.execute("CREATE TABLE meta (key, value)")
    connection.close()
    for use in (
        lambda: Store.read(path),
        lambda: Store.resume(path),
        lambda: Store.create(path, *BOTH),
    ):
        assert str(told(use)) == f"`{path}` is no store of experiences"


def test_a_newer_version(path: Path) -> None:
    Store.create(path, *BOTH).close()
    connection = sqlite3.connect(path)
    connection.execute("PRAGMA user_version = 99")
    connection.close()
    for use in (lambda: Store.read(path), lambda: Store.resume(path)):
        error = told(use)
        assert f"the store `{path}` has version 99, and this menid-plan knows none" in str(error)


@pytest.mark.parametrize("seed", range(12))
def test_damage_is_told(path: Path, seed: int) -> None:
    with Store.create(path, *BOTH) as store:
        store.add(test_of(i, state=state("lit" if i % 2 else "worn left")) for i in range(3000))
    data = bytearray(path.read_bytes())
    if seed == 0:
        del data[len(data) // 2 :]
    else:
        page = 4096 * (seed * (len(data) // 4096) // 12)
        data[page + 1000 : page + 4000 : 7] = bytes([0xAB]) * len(range(1000, 4000, 7))
        if page:  # the first 100 bytes of a page's head say what the page is
            data[page : page + 100] = bytes([0xAB]) * 100
    path.write_bytes(data)

    error = told(lambda: Store.resume(path, *BOTH))
    assert str(path) in str(error)
    assert error.exit_code in (3, 5)
    try:
        with Store.read(path) as reader:
            found = list(reader)
            reader.counts()
    except StoreError:
        return
    # A reader may not come by what is damaged, an index say; then what it reads is right.
    assert [e.number for e in found] == list(range(3000))


# ------------------------------------------------------------------------------------------ migration


def old_store(path: Path) -> None:
    """A store of version 1, made by hand."""
    tables = schema.TABLES.replace(",\n    role TEXT NOT NULL\n", "\n")
    assert "role" not in tables
    connection = sqlite3.connect(path, isolation_level=None)
    connection.executescript(tables)
    text = menid_plan.write(BOTH[0])
    meta = {
        "domain": text, "problem": menid_plan.write(BOTH[1]), "settings": "{}", "seed": "null",
        "domain_hash": "?", "problem_hash": "?", "created": "2020-01-01T00:00:00+00:00",
    }  # fmt: skip
    connection.executemany("INSERT INTO meta VALUES (?, ?)", meta.items())
    connection.executescript(
        """
        INSERT INTO environments (name) VALUES ('room'), ('model'), ('sketch');
        INSERT INTO states (atoms) VALUES (''), ('lit');
        INSERT INTO actions (text) VALUES ('press(left)');
        INSERT INTO explanations (action, rule, per, weights)
            VALUES ('press', 'dark', '["left"]', '[1.0, 0.0, 0.0]');
        INSERT INTO experiences
            (environment, state, action, after, step, test, reward, duration, seed, finished,
             explanation)
            VALUES (1, 1, 1, 2, 0, NULL, NULL, 0.25, 1000, 1.7e9, 1),
                   (2, 1, 1, 2, NULL, 0, NULL, 0.25, 1000, 1.7e9, 1);
        """
    )
    connection.execute(f"PRAGMA application_id = {schema.APPLICATION}")
    connection.execute("PRAGMA user_version = 1")
    connection.close()


def version(path: Path) -> int:
    connection = sqlite3.connect(path)
    found = int(connection.execute("PRAGMA user_version").fetchone()[0])
    connection.close()
    return found


def test_an_older_version_is_migrated(path: Path) -> None:
    old_store(path)
    expected = [test_of(0, environment="room"), test_of(0)]
    with Store.read(path) as reader:
        assert list(reader) == expected
        assert reader.roles == {"room": "target", "model": "test", "sketch": "test"}
    assert version(path) == 1  # a reader changes nothing on the disk
    with Store.resume(path, *BOTH) as store:
        assert store.roles == {"room": "target", "model": "test", "sketch": "test"}
        assert store.add([*expected, test_of(1, environment="room")]) == 1
        assert store.next_step() == 2
    assert version(path) == schema.VERSION


def test_a_migration_that_fails_changes_nothing(
    path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    old_store(path)

    def fails(connection: sqlite3.Connection) -> None:
        schema._add_roles(connection)
        connection.execute("SELECT nonsense")

    monkeypatch.setitem(schema._MIGRATIONS, 1, fails)
    told(lambda: Store.resume(path))
    monkeypatch.undo()
    assert version(path) == 1
    Store.resume(path).close()


# -------------------------------------------------------------------------- kills, full disks, rights

WRITER = """
import os, random, signal, sys, time
sys.path[:0] = sys.argv[2:]
from test_store import BOTH, Store, test_of
from menid_plan.grounding.state import GroundAction

path, kills = sys.argv[1], 12
random.seed(3)
Store.create(path, *BOTH).close()
for kill in range(kills):
    acknowledged, written = os.pipe()
    child = os.fork()
    if child == 0:
        store = Store.resume(path, *BOTH)
        begin = len(store)
        while True:
            store.add([test_of(n) for n in range(begin, begin + 50)])
            begin += 50
            os.write(written, f"{begin}\\n".encode())
    os.close(written)
    # Half of them are killed wherever they are, the others once they have written something.
    text = os.read(acknowledged, 65536) if kill % 2 else b""
    time.sleep(random.uniform(0.005, 0.06))
    os.kill(child, signal.SIGKILL)
    os.waitpid(child, 0)
    while data := os.read(acknowledged, 65536):
        text += data
    os.close(acknowledged)
    lines = [line for line in text.split(b"\\n")[:-1]]
    # In a process of its own: what is opened here must not be carried into the next writer.
    reader = os.fork()
    if reader == 0:
        with Store.read(path) as store:
            numbers = [e.number for e in store]
        with Store.resume(path, *BOTH) as store:
            again = [e.number for e in store]
        least = int(lines[-1]) if lines else 0
        good = numbers == again == list(range(len(numbers)))
        good = good and len(numbers) % 50 == 0 and least <= len(numbers)
        print(len(numbers), least, flush=True)
        os._exit(0 if good else 1)
    assert os.waitpid(reader, 0)[1] == 0
"""


@pytest.mark.skipif(not hasattr(os, "fork"), reason="needs processes that fork")
def test_a_writer_that_is_killed_leaves_whole_batches(path: Path) -> None:
    done = subprocess.run(
        [sys.executable, "-c", WRITER, path, ROOT / "tests", ROOT],
        capture_output=True, text=True, check=False, timeout=120,
    )  # fmt: skip
    assert done.returncode == 0, done.stdout + done.stderr
    lengths = [int(line.split()[0]) for line in done.stdout.splitlines()]
    assert len(lengths) == 12
    assert lengths == sorted(lengths)
    assert lengths[-1] > 0


FULL = """
import resource, signal, sys
sys.path[:0] = sys.argv[2:]
from test_store import BOTH, Store, StoreError, test_of
from dataclasses import replace
signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
with Store.create(sys.argv[1], *BOTH) as store:
    resource.setrlimit(resource.RLIMIT_FSIZE, (400_000, resource.RLIM_INFINITY))
    added = 0
    try:
        while True:
            store.add([test_of(n) for n in range(added, added + 1000)])
            added += 1000
    except StoreError as error:
        print(error.exit_code, error)
    print(added, len(store))
    resource.setrlimit(resource.RLIMIT_FSIZE, (resource.RLIM_INFINITY, resource.RLIM_INFINITY))
    print(store.add([test_of(n) for n in range(added, added + 1000)]), len(store))
"""


@pytest.mark.skipif(sys.platform == "win32", reason="needs limits on the size of files")
def test_a_full_disk(path: Path) -> None:
    done = subprocess.run(
        [sys.executable, "-c", FULL, path, ROOT / "tests", ROOT],
        capture_output=True, text=True, check=True, timeout=60,
    )  # fmt: skip
    told, kept, freed = done.stdout.splitlines()
    assert told.startswith(f"5 cannot write to the store `{path}`: the disk is full")
    added = int(kept.split()[0])
    assert added >= 1000
    assert kept == f"{added} {added}"
    assert freed == f"1000 {added + 1000}"  # once there is room, it goes on
    with Store.read(path) as reader:
        assert [e.number for e in reader] == list(range(added + 1000))


ORDINARY = """
import os, sys
sys.path[:0] = sys.argv[2:]
from test_store import Store
if os.getuid() == 0:
    os.setuid(65534)
from menid_plan.errors import MenidError
with Store.read(sys.argv[1]) as reader:
    print(len(list(reader)))
try:
    Store.resume(sys.argv[1])
except MenidError as error:
    print(error.exit_code, error)
"""


@pytest.mark.skipif(sys.platform == "win32", reason="needs the rights of POSIX")
@pytest.mark.parametrize("logged", [False, True])
def test_a_folder_that_may_only_be_read(logged: bool) -> None:
    # Not in pytest's own folder, into which another user may not look.
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name).resolve()
        path = folder / "run.store"
        with Store.create(path, *BOTH) as store:
            store.add([test_of(0)])
        if logged:  # as a writer leaves it that closes while somebody reads
            connection = sqlite3.connect(path)
            connection.execute("PRAGMA journal_mode = WAL")
            connection.close()
        path.chmod(0o444)
        folder.chmod(0o555)
        try:
            done = subprocess.run(
                [sys.executable, "-c", ORDINARY, path, ROOT / "tests", ROOT],
                capture_output=True, text=True, check=False, timeout=60,
            )  # fmt: skip
        finally:
            folder.chmod(0o755)
        assert done.returncode == 0, done.stderr
        assert [p.name for p in folder.iterdir() if "lock" not in p.name] == ["run.store"]
    length, error = done.stdout.splitlines()
    assert length == "1"
    assert error.startswith(f"5 cannot open the store `{path}`: it may not be written to")


def test_a_folder_that_is_not_there(tmp_path: Path) -> None:
    error = told(lambda: Store.create(tmp_path / "none" / "run.store", *BOTH))
    assert error.exit_code == 5
    assert "cannot write to the store" in str(error)
    assert "it cannot be opened" in str(error)


def test_meanings_of_errors(path: Path) -> None:
    connection = sqlite3.connect(":memory:")
    wanted = r"cannot read the store .*: no such table: none"
    with pytest.raises(StoreError, match=wanted), files.guarded(path, "read"):
        connection.execute("SELECT * FROM none")
    connection.close()


def test_an_interrupted_batch_is_not_there(store: Store) -> None:
    def interrupted() -> Iterator[Experience]:
        yield test_of(0, state=state("worn right"))
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        store.add(interrupted())
    assert len(store) == 0
    store.add([test_of(0, state=state("worn right"))])
    assert list(store) == [test_of(0, state=state("worn right"))]


DAMAGE = {
    "UPDATE states SET atoms = 'lit(' WHERE atoms = 'lit'": "experience 1: `lit(` is no list",
    "UPDATE states SET atoms = 'dark' WHERE atoms = 'lit'": "experience 1: `dark`: there is no pred",
    "UPDATE states SET atoms = x'ff' WHERE atoms = 'lit'": "experience 1: it is no text",
    "UPDATE states SET atoms = CAST(x'ff' AS TEXT) WHERE atoms = 'lit'": "UTF-8",
    "INSERT INTO states (atoms) VALUES ('dark')": "state 3: `dark`: there is no predicate",
    "UPDATE actions SET text = 'a, b'": "experience 1: its explanation is of another action",
    "UPDATE actions SET text = 'lit, press(left)'": "experience 1: its explanation is of another",
    "UPDATE actions SET text = 'press(up)'": "experience 1: `press(up)`: there is no object `up`",
    "UPDATE explanations SET rule = 'gone'": "experience 1: there is no rule `press.gone`",
    "UPDATE explanations SET weights = '{'": "experience 1: its values or weights are no JSON",
    "UPDATE explanations SET weights = '7'": "experience 1: its values or weights are no list",
    "UPDATE explanations SET weights = '[1.0, 0.0]'": "has 3 outcomes, and 2 weights are given",
    "UPDATE explanations SET weights = '[5.0, -4.0, 0.0]'": "no shares that sum to 1: 5.0, -4.0, 0.0",
    "UPDATE explanations SET weights = '[NaN, 1, 0]'": "no shares that sum to 1",
    "UPDATE explanations SET per = '[]'": "experience 1: the values of rule `press.dark`",
    "UPDATE experiences SET reward = 'abc' WHERE id = 2": "experience 2: its reward is no finite",
    "UPDATE experiences SET duration = -5": "experience 1: its duration is no finite number >= 0",
    "UPDATE experiences SET duration = 9e999": "experience 1: its duration is no finite number",
    "UPDATE experiences SET finished = 'now'": "experience 1: the time of its end is no finite",
    "UPDATE experiences SET seed = '1x'": "experience 1: its seed is no whole number",
    "UPDATE experiences SET state = 77": "experience 1: its state is not there",
    "UPDATE experiences SET after = 77 WHERE id = 2": "experience 2: its state after is not there",
    "UPDATE experiences SET explanation = 77": "experience 1: its explanation is not there",
    "UPDATE experiences SET test = 'a' WHERE id = 1": "experience 1: it is a test, and its number",
    "UPDATE experiences SET step = 1 WHERE id = 1": "experience 1: it is a test, and its number",
    "DELETE FROM states": "experience 1: its state is not there",
    "DELETE FROM environments": "environment `room` of its domain is not there",
    "UPDATE environments SET role = 'test'": "the role of environment `room` is not target",
    "INSERT INTO environments VALUES (9, 'x', 'test')": "an environment that is not in its domain",
    "DROP TABLE actions": "no such table",
    "DELETE FROM meta WHERE key = 'settings'": "`settings` is not in its table `meta`",
    "DELETE FROM meta WHERE key = 'domain'": "`domain` is not in its table `meta`",
    "UPDATE meta SET value = '{bad' WHERE key = 'settings'": "its `settings` is no JSON object",
    "UPDATE meta SET value = '[]' WHERE key = 'settings'": "its `settings` is no JSON object",
    "UPDATE meta SET value = 'x' WHERE key = 'seed'": "its `seed` is no whole number",
    "UPDATE meta SET value = 'domain' WHERE key = 'domain'": "the text of its domain or problem: ",
    "UPDATE meta SET value = '' WHERE key = 'problem'": "the text of its",
    "PRAGMA user_version = 0": "it has the version 0",
    "PRAGMA user_version = -3": "it has the version -3",
}


@pytest.mark.parametrize("statement", DAMAGE)
def test_tables_that_somebody_changed(path: Path, statement: str) -> None:
    with Store.create(path, *BOTH) as store:
        store.add([test_of(0), test_of(1)])
    connection = sqlite3.connect(path)
    connection.execute(statement)
    connection.commit()
    connection.close()
    errors = [
        told(lambda: Store.read(path)),
        told(lambda: Store.resume(path)),
        told(lambda: Store.create(path, *BOTH, resume=True)),
    ]
    for error in errors:
        assert error.exit_code == 3
        assert f"the store `{path}`" in str(error)
        assert "is damaged: " in str(error)
        assert DAMAGE[statement] in str(error)


def test_a_store_of_version_1_that_is_damaged(path: Path) -> None:
    old_store(path)
    connection = sqlite3.connect(path)
    connection.execute("DELETE FROM meta WHERE key = 'domain'")
    connection.commit()
    connection.close()
    for use in (lambda: Store.read(path), lambda: Store.resume(path)):
        assert "it has no domain that can be read" in str(told(use))
    assert version(path) == 1


@pytest.mark.parametrize(
    "changes",
    [
        {"state": state("dark")},
        {"after": frozenset({GroundAtom("worn", ("up",))})},
        {"action": GroundAction("press", ("up",)), "explanation": None},
        {"action": GroundAction("pull"), "explanation": None},
        {"explanation": replace(DARK, rule="gone")},
        {"explanation": replace(DARK, weights=(5.0, -4.0, 0.0))},
        {"explanation": replace(DARK, values=())},
    ],
)
def test_what_could_not_be_read_back_is_not_written(
    store: Store, changes: dict[str, object]
) -> None:
    with pytest.raises(ValueError, match="no experience"):
        store.add([test_of(0), test_of(1, **changes)])
    assert len(store) == 0


def test_the_columns_are_as_documented(store: Store, path: Path) -> None:
    """The page's list of tables names every table and column."""
    page = (ROOT / "docs" / "experiences.md").read_text(encoding="utf-8")
    connection = sqlite3.connect(path)
    tables = [n for (n,) in connection.execute("SELECT name FROM sqlite_master WHERE type='table'")]
    for table in tables:
        assert f"`{table}`" in page
        for column in connection.execute(f"PRAGMA table_info({table})"):
            assert f"`{column[1]}`" in page
    for (key,) in connection.execute("SELECT key FROM meta"):
        assert f"`{key}`" in page
    connection.close()
