"""`menid report`: the page, read back by a parser and by a browser, against the runs' own files."""

from __future__ import annotations

import csv
import json
import re
import shutil
import sqlite3
import subprocess
import xml.etree.ElementTree as ET
from collections.abc import Callable
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pytest
from click.testing import Result

from learning_runs import LEVERS
from menid_plan.experience.store import Store
from menid_plan.learning.clock import clock_text
from menid_plan.report.run import read_run

pytest.importorskip("matplotlib", reason="the extra `draw` is not installed")
pytest.importorskip("jinja2", reason="the extra `draw` is not installed")

Menid = Callable[..., Result]

RUN_FILE = """\
[environment.bench]
kind = "simulated"
duration = 20
[environment.model]
kind = "simulated"
[workers]
number = 0
[learn]
test_time = 4
steps = 12
seed = 3
"""
VOID = {"meta", "img", "br", "link", "input", "hr", "base"}
# The smallest GIF image.
GIF = b"GIF89a\x01\x00\x01\x00\x00\x00\x00;"


class Page(HTMLParser):
    """The elements of a page with their attributes and texts, and its tables as lists of rows."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.elements: list[tuple[str, dict[str, str]]] = []
        self.tables: list[list[list[str]]] = []
        self.text = ""
        self.headings: list[int] = []
        self._open: list[str] = []
        self._cell = False
        self.feed(text)
        self.close()
        assert self._open == []

    def handle_starttag(self, tag: str, attributes: list[tuple[str, str | None]]) -> None:
        self.elements.append((tag, {name: value or "" for name, value in attributes}))
        if tag not in VOID:
            self._open.append(tag)
        if re.fullmatch("h[1-6]", tag):
            self.headings.append(int(tag[1]))
        match tag:
            case "table":
                self.tables.append([])
            case "tr":
                self.tables[-1].append([])
            case "th" | "td":
                self.tables[-1][-1].append("")
                self._cell = True

    def handle_startendtag(self, tag: str, attributes: list[tuple[str, str | None]]) -> None:
        self.elements.append((tag, {name: value or "" for name, value in attributes}))

    def handle_endtag(self, tag: str) -> None:
        assert self._open.pop() == tag
        if tag in ("th", "td"):
            self._cell = False

    def handle_data(self, data: str) -> None:
        if "style" in self._open:
            return
        self.text += data
        if self._cell:
            self.tables[-1][-1][-1] += data

    def of(self, tag: str) -> list[dict[str, str]]:
        return [attributes for name, attributes in self.elements if name == tag]

    def table(self, head: str) -> list[list[str]]:
        """The first table whose first cell has that text, its cells without white space around them."""
        for table in self.tables:
            if table[0][0].strip() == head:
                return [[" ".join(cell.split()) for cell in row] for row in table]
        raise AssertionError(f"no table begins with {head}")


@pytest.fixture
def levers(menid: Menid) -> Menid:
    """Runs `menid` beside a run of the levers in `out`."""
    Path("levers.menid").write_text(LEVERS, encoding="utf-8")
    Path("run.toml").write_text(RUN_FILE, encoding="utf-8")
    assert learn(menid).exit_code == 0
    return menid


def learn(menid: Menid, *options: str, out: str = "out") -> Result:
    return menid("learn", "levers.menid", "--run", "run.toml", "-o", out, *options)


def page_of(menid: Menid, *folders: str, output: str = "page.html") -> Page:
    result = menid("report", *folders, "-o", output)
    assert result.exit_code == 0, result.stderr
    assert result.stdout == f"wrote {output}\n"
    return Page(Path(output).read_text(encoding="utf-8"))


def curve(folder: str = "out") -> list[dict[str, str]]:
    with Path(folder, "curve.csv").open(newline="") as file:
        return list(csv.DictReader(file))


# ---------------------------------------------------------------------------------- what it tells


def test_the_summary_is_that_of_the_run(levers: Menid) -> None:
    said = json.loads(learn(levers, "--resume", "--json").stdout)
    facts = dict(row[:2] for row in page_of(levers, "out").table("run"))
    assert facts["run"] == "out"
    assert facts["steps"] == str(said["steps"]) == "12"
    assert facts["episodes"] == str(said["episodes"])
    assert facts["to the goal"] == str(said["successes"])
    assert float(facts["accumulated reward"]) == said["reward"]
    assert facts["tests"] == str(said["environments"]["model"]["executions"])
    assert facts["time"] == clock_text(said["seconds"])
    assert facts["best first action"] == said["action"]
    value, objective = facts["its value"].split()
    assert float(value) == pytest.approx(said["value"], abs=1e-4)
    assert objective == f"({said['objective']})"
    assert facts["seed"] == "3"
    assert facts["end"] == "ended"


def test_executions_and_times_are_those_of_the_store(levers: Menid) -> None:
    rows = page_of(levers, "out").table("environment")[1:]
    with Store.read("out/experiences.sqlite") as store:
        totals = store.totals()
    spent = sum(each.seconds for each in totals.values())
    for name, row in zip(("bench", "model"), rows, strict=True):
        assert row == [
            name, store.roles[name], str(totals[name].executions), clock_text(totals[name].seconds),
            f"{100 * totals[name].seconds / spent:.1f} %",
        ]  # fmt: skip


def test_curves_are_those_of_the_run(levers: Menid) -> None:
    run = read_run(Path("out"))
    rows = curve()
    assert [p.reward for p in run.points] == [float(row["reward"]) for row in rows]
    bench, model = (np.array(place.course) for place in run.places)
    assert bench.tolist() == [int(row["steps"]) for row in rows]
    assert model.tolist() == [int(row["tests"]) for row in rows]
    # Of what is drawn, read back from the page: heights follow the numbers.
    page_of(levers, "out")
    text = Path("page.html").read_text(encoding="utf-8")
    drawn = next(each for each in re.findall(r"<svg .*?</svg>", text, re.S) if "rewards-" in each)
    line = next(
        path.attrib["d"]
        for path in ET.fromstring(drawn).iter("{http://www.w3.org/2000/svg}path")
        if "var(--line-0)" in path.attrib.get("style", "")
    )
    numbers = np.array(re.findall(r"-?\d+\.?\d*", line), np.float64).reshape(-1, 2)
    heights = np.unique(-numbers[:, 1])
    rewards = np.unique([0.0, *(p.reward for p in run.points)])
    assert len(heights) == len(rewards) > 2
    scale = (heights[-1] - heights[0]) / (rewards[-1] - rewards[0])
    assert heights - heights[0] == pytest.approx(scale * (rewards - rewards[0]), abs=1e-3)


def test_few_executions_beside_many_are_drawn_too(levers: Menid) -> None:
    assert learn(levers, "--test-time", "60", "--steps", "1", out="tested").exit_code == 0
    page = page_of(levers, "tested")
    assert "executions (logarithmic)" in page.text
    assert "$" not in page.text  # no TeX
    assert "executions (logarithmic)" not in page_of(levers, "out").text


def test_probabilities_and_counts_are_those_that_were_learned(levers: Menid) -> None:
    known = json.loads(levers("estimate", "levers.menid", "out", "--json").stdout)
    rows = page_of(levers, "out").table("outcome")[1:]
    for each in known["rules"]:
        values = f" for l = {each['for'][0]}" if each["for"] else ""
        head = next(
            row for row in rows if row[0].startswith(f"{each['action']}.{each['rule']}{values}")
        )
        for environment in ("bench", "model"):
            told = f"δ {each['delta'][environment]:.3f} in {environment}"
            assert (told in head[0]) == any(each["counts"][environment])
        place = rows.index(head)
        for i, outcome in enumerate(each["outcomes"]):
            name, estimate, interval, _, _, bench, model, _ = rows[place + 1 + i]
            assert (name, estimate) == (outcome, f"{each['estimate'][i]:.3f}")
            low, high = map(float, interval.split(" to "))
            assert low - 5e-4 <= each["estimate"][i] <= high + 5e-4
            for cell, environment in ((bench, "bench"), (model, "model")):
                counts = each["counts"][environment]
                number, *share = cell.split()
                assert float(number) == pytest.approx(counts[i], rel=1e-5)
                assert share == ([f"{counts[i] / sum(counts):.3f}"] if any(counts) else [])
    assert len(rows) == sum(1 + len(each["outcomes"]) for each in known["rules"])
    finish = next(row for row in rows if row[0] == "works")
    assert finish[4] == "0.900"  # as the domain has it


def test_gaps_are_sorted_and_judged(levers: Menid) -> None:
    text = LEVERS.replace("moves:  0.6 0.8 0.5", "moves:  0.0 0.8 0.5").replace(
        "sticks: 0.3 0.2 0.5", "sticks: 1.0 0.2 0.5"
    )
    Path("levers.menid").write_text(text.replace("noise:  0.1", "noise:  0.0"), encoding="utf-8")
    assert learn(levers, "--steps", "40", "--seed", "1", out="wrong").exit_code == 0
    rows = page_of(levers, "wrong").table("distribution")[1:]
    gaps = [float(row[3]) for row in rows]
    assert gaps == sorted(gaps, reverse=True)
    first = rows[0]
    assert first[0].startswith("pull.dry for ")
    assert first[2] == "model"
    assert gaps[0] > 0.5
    assert first[-1] == "more than chance"
    here, there = float(first[5].split()[0]), float(first[6].split()[0])
    assert abs(here - there) == pytest.approx(gaps[0], abs=2e-3)


def test_the_policy_is_the_one_that_solve_finds(levers: Menid) -> None:
    rows = page_of(levers, "out").table("state")[1:]
    Path("task.menid").write_text("problem task" + LEVERS.partition("problem task")[2])
    solved = levers("solve", "out/learned.menid", "task.menid", "-o", "policy.json", "--json")
    assert float(rows[0][3]) == pytest.approx(json.loads(solved.stdout)["value"], abs=1e-4)
    policy = json.loads(Path("policy.json").read_text(encoding="utf-8"))
    decided = [row[2] for row in rows if row[2] not in ("goal", "dead end")]
    assert sorted(decided) == sorted(each["action"] for each in policy["states"])
    for row in rows:
        led = [float(p) for p in re.findall(r"\((0\.\d+|1\.0+)\)", row[4])]
        assert sum(led) == pytest.approx(1.0 if row[2] in decided else 0.0, abs=2e-3)


def test_a_large_policy_is_shown_by_its_likeliest_way(
    levers: Menid, monkeypatch: pytest.MonkeyPatch
) -> None:
    policy = page_of(levers, "out").table("state")
    monkeypatch.setattr("menid_plan.exchange.drawing.MAX_NODES", 2)
    page = page_of(levers, "out")
    assert "since the policy comes to" in page.text
    first, second = page.table("step")[1:]
    assert first[1:3] == policy[1][2:4]
    # From the beginning the likeliest outcome that leads on, as the table of all states has it.
    assert f"({first[3]})" in policy[1][4]
    assert first[4] == "+ ready"
    assert (second[1], second[4]) == ("finish", "+ done")
    assert "A goal is reached." in page.text


def test_settings_and_versions(levers: Menid) -> None:
    page = page_of(levers, "out")
    settings = dict(row[:2] for row in page.table("setting")[1:])
    kept = json.loads(Path("out/settings.json").read_text(encoding="utf-8"))
    for name, value in kept["learn"].items():
        if value != {}:
            assert json.loads(settings[f"learn.{name}"]) == value
    assert settings["environments.bench.kind"] == '"simulated"'
    starts = json.loads(Path("out/events.jsonl").read_text(encoding="utf-8").splitlines()[0])
    for name, version in starts["versions"].items():
        assert f"{name} {version}" in page.text


# ---------------------------------------------------------------------------------- several runs


def test_runs_are_compared(levers: Menid) -> None:
    learn(levers, "--seed", "4", out="other")
    learn(levers, "--test-time", "0", out="baseline")
    page = page_of(levers, "out", "other", "baseline")
    head, *rows = page.table("run")
    assert [row[0] for row in rows] == ["out", "other", "baseline"]
    for row in rows:
        facts = dict(zip(head, row, strict=True))
        last = curve(row[0])[-1]
        assert float(facts["accumulated reward"]) == float(last["reward"])
        assert facts["tests"] == last["tests"]
    assert [row[head.index("seed")] for row in rows] == ["3", "4", "3"]
    assert [row[head.index("test time")] for row in rows] == ["4 s", "4 s", "0 s"]
    assert "estimator" not in head  # it is the same in all
    # The two with the same settings share a line.
    assert "out, other" in page.text
    assert page.text.count("Of runs that differ in their seed alone") == 1
    differing = {row[0]: row[1:] for row in page.table("setting")[1:]}
    assert differing["learn.seed"] == ["3", "4", "3"]
    assert differing["learn.test_time"] == ["4.0", "4.0", "0.0"]
    assert set(differing) == {"learn.seed", "learn.test_time"}


def test_the_mean_of_runs(levers: Menid) -> None:
    from menid_plan.report.figures import groups_of

    learn(levers, "--seed", "4", out="other")
    runs = [read_run(Path(name)) for name in ("out", "other")]
    (group,) = groups_of(runs)
    seconds, mean, low, high = group.means()
    assert seconds[-1] == min(run.points[-1].seconds for run in runs)
    for i in (0, len(seconds) // 2, len(seconds) - 1):
        now = [
            ([0.0] + [p.reward for p in run.points if p.seconds <= seconds[i]])[-1] for run in runs
        ]
        assert (mean[i], low[i], high[i]) == (np.mean(now), min(now), max(now))


def test_runs_of_different_domains_are_told_of(levers: Menid) -> None:
    text = LEVERS.replace("domain levers", "domain cranks").replace("for levers", "for cranks")
    Path("levers.menid").write_text(text, encoding="utf-8")
    learn(levers, out="cranks")
    page = page_of(levers, "out", "cranks")
    assert "not all of one domain" in page.text
    assert "not all of one domain" not in page_of(levers, "out").text


def test_runs_of_one_name_are_told_apart(levers: Menid) -> None:
    Path("a").mkdir()
    Path("b").mkdir()
    for folder in ("a", "b"):
        shutil.copytree("out", Path(folder, "out"))
    page = page_of(levers, "a/out", "b/out")
    assert [row[0] for row in page.table("run")[1:]] == ["a/out", "b/out"]


# ------------------------------------------------------------------------------ a page of its own


def assert_harmless(page: Page) -> None:
    """Nothing is loaded, nothing runs, and every id is there once."""
    for tag, attributes in page.elements:
        assert tag not in ("script", "link", "iframe", "object", "embed", "base", "form")
        for name, value in attributes.items():
            assert not name.startswith("on")
            if name in ("src", "href", "xlink:href", "srcset", "data", "action"):
                assert value.startswith(("#", "data:image/gif;base64,"))
            if name == "style":
                assert not re.search(r"url\((?!#)|@import", value)
    ids = [attributes["id"] for _, attributes in page.elements if "id" in attributes]
    assert len(ids) == len(set(ids)) > 5
    named = {value for tag, a in page.elements for name, value in a.items() if "href" in name}
    assert {value[1:] for value in named} <= set(ids)
    policy = next(a for a in page.of("meta") if a.get("http-equiv") == "Content-Security-Policy")
    assert "default-src 'none'" in policy["content"]


def test_nothing_is_loaded_from_elsewhere(levers: Menid) -> None:
    learn(levers, "--seed", "4", out="other")
    page = page_of(levers, "out", "other")
    assert_harmless(page)
    style = re.search(r"<style>(.*?)</style>", Path("page.html").read_text(), re.S)
    assert style
    assert "url(" not in style[1]
    assert "@import" not in style[1]


def test_it_can_be_read_by_everyone(levers: Menid) -> None:
    learn(levers, "--seed", "4", out="other")
    page = page_of(levers, "out", "other")
    assert page.of("html")[0]["lang"] == "en"
    assert page.headings[0] == 1
    assert page.headings.count(1) == 1
    assert all(
        after <= before + 1 for before, after in zip(page.headings, page.headings[1:], strict=False)
    )
    assert all(
        attributes.get("scope") in ("col", "row", "rowgroup") for attributes in page.of("th")
    )
    figures = [attributes for attributes in page.of("div") if attributes.get("role") == "img"]
    assert len(figures) == 3
    assert all(attributes["aria-label"] for attributes in figures)


def test_names_are_no_markup(levers: Menid) -> None:
    evil = "<script>alert(1)</script>&amp;'\"$x_1$"
    Path(evil.replace("/", "\\")).mkdir()
    folder = evil.replace("/", "\\")
    shutil.copytree("out", folder, dirs_exist_ok=True)
    # Texts of the domain and what an environment said come from others, too.
    with sqlite3.connect(Path(folder, "experiences.sqlite")) as store:
        (settings,) = store.execute("SELECT value FROM meta WHERE key = 'settings'").fetchone()
        changed = json.loads(settings)
        changed["environments"]["bench"]["settings"]["<img src=x onerror=alert(2)>"] = "<b>\ud800"
        store.execute("UPDATE meta SET value = ? WHERE key = 'settings'", (json.dumps(changed),))
    store.close()
    with Path(folder, "events.jsonl").open("a") as file:
        file.write(json.dumps({"event": "failed", "message": "</style><script>alert(3)//"}) + "\n")
    page = page_of(levers, folder, "out")
    assert_harmless(page)
    assert [tag for tag, _ in page.elements if tag == "b"] == []
    assert page.table("run")[1][0] == folder
    assert "failed: </style><script>alert(3)//" in page.text
    assert "<img src=x onerror=alert(2)>" in page.text


def test_the_same_runs_give_the_same_page(levers: Menid) -> None:
    learn(levers, "--seed", "4", out="other")
    page_of(levers, "out", "other")
    page_of(levers, "out", "other", output="again.html")
    assert Path("page.html").read_bytes() == Path("again.html").read_bytes()
    # A run that is resumed and has nothing more to do has the same numbers.
    learn(levers, "--resume")
    once = page_of(levers, "out", "other", output="resumed.html")
    assert once.tables == Page(Path("page.html").read_text(encoding="utf-8")).tables


def test_reading_changes_nothing(levers: Menid) -> None:
    with Path("out/events.jsonl").open("a") as file:
        file.write('{"event": "res')  # a line that a kill has cut
    before = {path.name: path.read_bytes() for path in Path("out").iterdir()}
    page_of(levers, "out")
    assert {path.name: path.read_bytes() for path in Path("out").iterdir()} == before


def test_a_film_is_shown(levers: Menid) -> None:
    Path("out/best.gif").write_bytes(GIF)
    page = page_of(levers, "out")
    assert_harmless(page)
    (image,) = page.of("img")
    assert image["src"] == "data:image/gif;base64,R0lGODlhAQABAAAAADs="
    assert image["alt"]
    Path("out/best.gif").write_bytes(b"<svg onload=alert(1)>")
    page = page_of(levers, "out")
    assert page.of("img") == []
    assert "best.gif is no GIF image" in page.text


# ------------------------------------------------------------------------- what is not as it should be


def test_a_run_that_was_killed(levers: Menid) -> None:
    rows = Path("out/curve.csv").read_text().splitlines(keepends=True)
    Path("out/curve.csv").write_text("".join(rows[:-2]) + rows[-2][:5])
    starts = Path("out/events.jsonl").read_text().splitlines(keepends=True)[0]
    Path("out/events.jsonl").write_text(starts)
    Path("out/learned.menid").unlink()
    result = levers("report", "out", "-o", "page.html")
    assert result.exit_code == 0
    assert "after the last point of the curve" in result.stderr
    page = Page(Path("page.html").read_text(encoding="utf-8"))
    facts = dict(row[:2] for row in page.table("run"))
    assert facts["end"].startswith("under way, or killed")
    assert facts["steps"] == "12"
    assert float(facts["accumulated reward"]) == float(rows[-3].split(",")[1])
    assert "under way, or killed; --resume goes on" in page.text


def test_a_run_that_is_under_way(levers: Menid) -> None:
    before = page_of(levers, "out").tables
    with Store.resume("out/experiences.sqlite"):  # somebody writes
        assert page_of(levers, "out").tables == before


def test_a_run_of_no_steps(levers: Menid) -> None:
    learn(levers, "--steps", "0", out="none")
    page = page_of(levers, "none")
    assert_harmless(page)
    assert "no execution was counted" in page.text
    assert dict(row[:2] for row in page.table("run"))["steps"] == "0"
    assert page_of(levers, "out", "none").text.count("no execution was counted") == 1


def test_files_that_are_missing(levers: Menid) -> None:
    Path("out/curve.csv").unlink()
    Path("out/events.jsonl").unlink()
    result = levers("report", "out", "-o", "page.html")
    assert result.exit_code == 0
    assert "curve.csv is missing" in result.stderr
    page = Page(Path("page.html").read_text(encoding="utf-8"))
    facts = dict(row[:2] for row in page.table("run"))
    assert facts["steps"] == "12"
    assert facts["accumulated reward"] == facts["time"] == "\N{EN DASH}"
    assert facts["end"] == "not known, since events.jsonl does not tell"


@pytest.mark.parametrize(
    ("file", "damage", "message"),
    [
        ("curve.csv", b"seconds,reward\n", "`out/curve.csv`, line 1 is not the head"),
        ("curve.csv", b"seconds,reward,steps,episodes,tests,what\n1.0,nan,1,0,0,step\n",
         "`out/curve.csv`, line 2 is no point of a learning curve; remove the file"),
        ("curve.csv", b"seconds,reward,steps,episodes,tests,what\n1.0,1.0,1000,0,0,step\n",
         "tells of 1000 executions, and the store has"),
        ("experiences.sqlite", b"", "is empty: the run has not begun"),
        ("experiences.sqlite", b"rubbish" * 1000, "is no store of experiences"),
    ],
)  # fmt: skip
def test_files_that_are_damaged(levers: Menid, file: str, damage: bytes, message: str) -> None:
    Path("out", file).write_bytes(damage)
    result = levers("report", "out", "-o", "page.html")
    assert result.exit_code == 3
    assert message in result.stderr
    assert not Path("page.html").exists()


def test_settings_that_no_run_has_written(levers: Menid) -> None:
    with sqlite3.connect("out/experiences.sqlite") as store:
        store.execute(
            """UPDATE meta SET value = '{"learn": {"epsilon": 7}}' WHERE key = 'settings'"""
        )
    store.close()
    result = levers("report", "out", "-o", "page.html")
    assert result.exit_code == 3
    assert "the settings in the store `out/experiences.sqlite` are no run's: " in result.stderr


def test_a_folder_that_is_no_run(levers: Menid) -> None:
    Path("empty").mkdir()
    result = levers("report", "out", "empty", "-o", "page.html")
    assert result.exit_code == 3
    assert "`empty` is not the folder of a run: it has no experiences.sqlite" in result.stderr
    assert levers("report", "nowhere", "-o", "page.html").exit_code == 2
    assert not Path("page.html").exists()


def test_where_it_may_not_be_written(levers: Menid) -> None:
    before = {path.name: path.read_bytes() for path in Path("out").iterdir()}
    for output, message in (
        ("out/learned.menid", "the file's ending must be .html"),
        ("nowhere/page.html", "there is no folder `nowhere`"),
    ):
        result = levers("report", "out", "-o", output)
        assert result.exit_code == 2
        assert message in result.stderr
    Path("link.html").symlink_to("out/experiences.sqlite")
    result = levers("report", "out", "-o", "link.html")
    assert result.exit_code == 2
    assert "is an input" in result.stderr
    assert levers("report", "out", "./out", "-o", "page.html").exit_code == 2
    assert {path.name: path.read_bytes() for path in Path("out").iterdir()} == before


def test_without_the_extra(levers: Menid, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(__import__("sys").modules, "jinja2", None)
    result = levers("report", "out", "-o", "page.html")
    assert result.exit_code == 5
    assert "pip install 'menid-plan[draw]'" in result.stderr


# -------------------------------------------------------------------------------------- in a browser

BROWSER = next(
    filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None
)

# Frames of the width of a phone; the page around them says how wide what is in them comes out.
WRAPPER = """\
<!doctype html><meta charset="utf-8"><body>
<iframe id="phone" src="page.html" style="width:{width}px;height:600px;border:0"></iframe>
<p id="width">?</p>
<script>
document.getElementById("phone").onload = (event) => {{
  const page = event.target.contentDocument.documentElement
  document.getElementById("width").textContent = page.scrollWidth + " of " + page.clientWidth
}}
</script>
"""


def browsed(path: Path, *options: str) -> subprocess.CompletedProcess[str]:
    assert BROWSER
    return subprocess.run(
        [BROWSER, "--headless", "--no-sandbox", "--disable-gpu", "--disable-background-networking",
         "--disable-dev-shm-usage", "--hide-scrollbars", "--virtual-time-budget=3000",
         "--enable-logging=stderr",
         f"--user-data-dir={path.parent / 'browser'}", *options, path.resolve().as_uri()],
        capture_output=True, text=True, timeout=120, check=True,
    )  # fmt: skip


@pytest.mark.skipif(BROWSER is None, reason="there is no Chromium")
def test_in_a_browser(levers: Menid, tmp_path: Path) -> None:
    Path("out/best.gif").write_bytes(GIF)
    long = "a-name-that-is-" + "very-" * 12 + "long"
    shutil.copytree("out", long)
    page = page_of(levers, "out", long)
    shown = browsed(tmp_path / "page.html", "--dump-dom")
    # What is refused, by the page's own policy or else, is told on the console.
    assert "CONSOLE" not in shown.stderr
    tables = Page(shown.stdout).tables
    assert [[row for row in table if row] for table in tables] == page.tables
    for width in (390, 320):
        (tmp_path / "wrapper.html").write_text(WRAPPER.format(width=width), encoding="utf-8")
        shown = browsed(tmp_path / "wrapper.html", "--dump-dom", "--allow-file-access-from-files")
        assert f'<p id="width">{width} of {width}</p>' in shown.stdout
