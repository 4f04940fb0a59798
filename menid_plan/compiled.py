"""Kernels: functions over arrays that Numba compiles once and later runs load as machine code.

Numba takes a second to start, more than most problems take to solve, and its own cache does not
spare a run that. So a kernel is compiled by Numba when it is first needed, and its object code is
kept on disk; from then on LLVM's loader alone (`llvmlite`) brings it in, in milliseconds.

This asks of a kernel that it allocates nothing and raises nothing: all its memory is handed to it.
Kernels may call kernels, and refer to numbers of their module.
"""

from __future__ import annotations

import ctypes
import hashlib
import re
import sys
import threading
from collections.abc import Callable
from contextlib import suppress
from functools import cached_property, lru_cache
from importlib.metadata import version
from pathlib import Path
from types import FunctionType
from typing import Any, TypeVar, cast

import numpy as np
from platformdirs import user_cache_path

from menid_plan.files import replace_file

_Function = TypeVar("_Function", bound=Callable[..., Any])

# Sums may be reordered (whoever bounds rounding allows for any order); infinities keep their meaning.
_OPTIONS: dict[str, Any] = {
    "nogil": True,
    "error_model": "numpy",
    "fastmath": {"reassoc", "contract", "nsz"},
    "no_cpython_wrapper": True,
    "no_cfunc_wrapper": True,
    # References are not counted: arrays come without an owner. (Numba leaves two calls for each row
    # that is taken out of an array, which may be a third of a kernel's time.)
    "_nrt": False,
}
_CTYPES: dict[str, Any] = {
    "b1": ctypes.c_bool, "i8": ctypes.c_int64, "f8": ctypes.c_double, "u8": ctypes.c_uint64,
}  # fmt: skip
_DTYPES = {
    "b1": np.dtype(np.bool_), "u1": np.dtype(np.uint8), "i4": np.dtype(np.int32),
    "u4": np.dtype(np.uint32), "i8": np.dtype(np.int64), "u8": np.dtype(np.uint64),
    "f8": np.dtype(np.float64),
}  # fmt: skip
_NO_BYTES = ctypes.c_char * 0
_ENTRY = "menid_kernel"
_LOCK = threading.RLock()  # LLVM and Numba compile and load in one thread at a time
_KNOWN_OUTSIDE = re.compile(r"llvm\.|mem(set|cpy|move)$|(sqrt|log|exp|pow|fabs|floor|ceil|fmod)f?$")


def kernel(signature: str = "", *, inline: bool = False) -> Callable[[_Function], _Function]:
    """Compile a function for one signature in Numba's notation (``"i8(f8[::1], b1)"``).

    Without a signature it is a part of the kernels that call it; ``inline`` spares them the call,
    which hands every field of every array over.
    """

    def decorate(function: _Function) -> _Function:
        return cast("_Function", Kernel(cast("FunctionType", function), signature, inline))

    return decorate


def _address(array: Any) -> int:
    """Where an array's data are."""
    try:  # in an eighth of the time that numpy takes to describe an array
        return ctypes.addressof(_NO_BYTES.from_buffer(array))
    except TypeError:  # it is read-only
        return int(array.__array_interface__["data"][0])


class Kernel:
    """A compiled function; loaded, or compiled, when it is first called."""

    def __init__(self, function: FunctionType, signature: str, inline: bool) -> None:
        self.function = function
        self.signature = signature
        self.inline = inline
        self.__doc__ = function.__doc__
        self._function: Any = None

    def __call__(self, *args: Any) -> Any:
        """Run it; arrays must have the types and the number of dimensions of the signature."""
        flat: list[Any] = []
        kinds = self._parameters
        if len(args) != len(kinds):
            raise TypeError(f"{self.name} takes {len(kinds)} arguments, got {len(args)}")
        for value, (dtype, dimensions) in zip(args, kinds, strict=True):
            if dimensions == 0:
                flat.append(value)
                continue
            if (
                value.dtype != dtype
                or value.ndim != dimensions
                or not value.flags.c_contiguous
            ):  # fmt: skip
                raise TypeError(
                    f"{self.name} takes a {dimensions}-d array of {dtype}, "
                    f"got a {value.ndim}-d array of {value.dtype}"
                )
            flat += (None, None, value.size, value.itemsize, _address(value))
            flat += value.shape
            flat += value.strides
        result = self._result()
        problem = ctypes.c_void_p()
        code = self._entry(ctypes.byref(result), ctypes.byref(problem), *flat)
        if code > 0 or code < -2:
            raise RuntimeError(f"{self.name} stopped with {code}")
        if self._result_type == "void":
            return None
        return tuple(result) if hasattr(result, "_length_") else result.value

    @property
    def name(self) -> str:
        """Module and function."""
        return f"{self.function.__module__}.{self.function.__name__}"

    @cached_property
    def _used(self) -> dict[str, Any]:
        """The kernels and numbers of its module by whose names (or attributes so named) it goes."""
        known = self.function.__globals__
        names = sorted(set(self.function.__code__.co_names))
        found = {name: known[name] for name in names if name in known}
        kinds = (Kernel, int, float)
        return {n: v for n, v in found.items() if isinstance(v, kinds) and v is not self}

    @cached_property
    def key(self) -> str:
        """A hash of all that the compiled code depends on but the machine."""
        source = _file_hash(self.function.__code__.co_filename)
        parts = [self.signature, str(self.inline), version("numba"), _file_hash(__file__), source]
        for name, value in self._used.items():
            parts.append(value.key if isinstance(value, Kernel) else f"{name}={value!r}")
        return hashlib.sha256("\n".join(parts).encode()).hexdigest()

    @cached_property
    def dispatcher(self) -> Any:
        """The function as Numba takes it, with those that it calls."""
        import numba

        names = dict(self.function.__globals__)
        for name, value in self._used.items():
            names[name] = value.dispatcher if isinstance(value, Kernel) else value
        copy = FunctionType(self.function.__code__, names, self.function.__name__)
        options = {**_OPTIONS, "inline": "always"} if self.inline else _OPTIONS
        return numba.njit(**options)(copy)

    # ------------------------------------------------------------------------ calling

    @cached_property
    def _result_type(self) -> str:
        return self.signature[: self.signature.index("(", 9 if "Tuple" in self.signature else 0)]

    @cached_property
    def _result(self) -> Any:
        """What the result is written into: a number, or several of one type."""
        several = re.fullmatch(r"UniTuple\((\w+), (\d)\)", self._result_type)
        if several:
            return _CTYPES[several[1]] * int(several[2])
        return _CTYPES.get(self._result_type, ctypes.c_void_p)

    @cached_property
    def _parameters(self) -> list[tuple[Any, int]]:
        """The type and the number of dimensions (0: a number) of each parameter."""
        inside = self.signature[len(self._result_type) + 1 : -1]
        found: list[tuple[Any, int]] = []
        for text in re.split(r",\s*(?![^\[]*\])", inside):
            base, _, rest = text.partition("[")
            if rest:
                found.append((_DTYPES[base], rest.count(",") + 1))
            else:
                found.append((_CTYPES[base], 0))
        return found

    def _entry(self, *arguments: Any) -> int:
        """Call the machine code, which the first caller loads."""
        if self._function is None:
            with _LOCK:
                if self._function is None:
                    self._function = self._as_function()
        return int(self._function(*arguments))

    def _as_function(self) -> Any:
        """The machine code as a function of C.

        It gets where to put the result and an exception; of each array the owner and the object
        (none), size, item size, data, shape and strides.
        """
        pointer, number = ctypes.c_void_p, ctypes.c_int64
        types: list[Any] = [pointer, pointer]
        for kind, dimensions in self._parameters:
            if dimensions:
                types += [pointer, pointer, number, number, pointer] + [number] * 2 * dimensions
            else:
                types.append(kind)
        return ctypes.CFUNCTYPE(ctypes.c_int32, *types)(self._load())

    # ----------------------------------------------------------------- compiling and loading

    def _load(self) -> int:
        """The address of the machine code."""
        import llvmlite.binding as llvm

        machine, mark = _machine()
        prefix = f"{self.name}.{mark}"
        kept = f"{prefix}-{self.key[:20]}.o"
        code = None
        for folder in _folders():
            with suppress(OSError):
                content = (folder / kept).read_bytes()
                if hashlib.sha256(content[32:]).digest() == content[:32]:
                    code = content[32:]
                    break
        if code is None:
            code = self._compile()
            _keep(kept, prefix, hashlib.sha256(code).digest() + code)
        engine = llvm.create_mcjit_compiler(llvm.parse_assembly(""), machine())
        engine.add_object_file(llvm.ObjectFileRef.from_data(code))
        engine.finalize_object()
        self._engine = engine  # the code lives as long as its engine
        return int(engine.get_function_address(_ENTRY))

    def _compile(self) -> bytes:
        """The object code."""
        import llvmlite.binding as llvm
        from numba.core.errors import NumbaError
        from numba.core.sigutils import normalize_signature

        _announce()
        try:
            self.dispatcher.compile(self.signature)
        except NumbaError as error:
            raise TypeError(f"{self.name} is no kernel: {error}") from error
        # Kernels that call this one may have compiled it for other types of theirs.
        arguments, _ = normalize_signature(self.signature)  # type: ignore[no-untyped-call]
        result = self.dispatcher.overloads[arguments]
        module = llvm.parse_assembly(self.dispatcher.inspect_llvm(arguments))
        for function in module.functions:
            if function.is_declaration and not _KNOWN_OUTSIDE.match(function.name):
                raise TypeError(f"{self.name} is no kernel: it needs {function.name}")
        module.get_function(result.fndesc.llvm_func_name).name = _ENTRY
        code: bytes = _machine()[0]().emit_object(module)
        return code


@lru_cache(maxsize=1)
def _machine() -> tuple[Callable[[], Any], str]:
    """How to make LLVM's description of this machine, and a short mark of it."""
    import llvmlite.binding as llvm

    llvm.initialize_native_target()
    llvm.initialize_native_asmprinter()
    triple = llvm.get_process_triple()
    cpu, features = llvm.get_host_cpu_name(), llvm.get_host_cpu_features().flatten()
    mark = hashlib.sha256("\n".join((triple, cpu, features)).encode()).hexdigest()[:8]

    def make() -> Any:
        target = llvm.Target.from_triple(triple)
        return target.create_target_machine(
            cpu=cpu, features=features, opt=3, codemodel="jitdefault", jit=True
        )

    return make, mark


@lru_cache(maxsize=1)
def _folders() -> tuple[Path, ...]:
    """Where object code is kept: beside the bytecode, or, if that can't be written, with the user."""
    return (
        Path(__file__).parent / "__pycache__",
        user_cache_path("menid-plan"),
    )


def _keep(name: str, prefix: str, content: bytes) -> None:
    """Write to the first folder that takes it, whole or not at all; what it replaces goes."""
    for folder in _folders():
        with suppress(OSError):
            folder.mkdir(parents=True, exist_ok=True)
            replace_file(folder / name, content)
            for old in folder.glob(f"{prefix}-*.o"):
                if old.name != name:
                    old.unlink(missing_ok=True)
            return


@lru_cache(maxsize=1)
def _announce() -> None:
    """Tell who watches that this takes long once."""
    if sys.stderr is not None and sys.stderr.isatty():
        print("compiling once, as this is the first run: half a minute", file=sys.stderr)


@lru_cache(maxsize=64)
def _file_hash(path: str) -> str:
    return hashlib.sha256(Path(path).read_bytes()).hexdigest()
