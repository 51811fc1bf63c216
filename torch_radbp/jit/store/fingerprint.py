"""Digests of what functions and values mean, equal in every process with the same source.

Compiled code outlives its process (`code_cache.py`), so its name must change with whatever it depends on: not only with the
function that was compiled, but with each function, class and constant that this one may reach. These are found as Python
finds them: from the code of a function through the globals, defaults and closures that it names, from a class through its
attributes and bases, whatever stands there now. So functions that were exchanged while the program runs, and those of
users' own plugins, count like any other. Of the standard library, torch and numpy, names stand for contents; their versions
belong to the name of the code, as the source of this compiler does. Modules of torch are no constants, and what takes one
as its first argument is not reached.
"""

from __future__ import annotations

import enum
import functools
import hashlib
import operator
import re
import sys
from collections.abc import Callable, Iterable
from dataclasses import fields, is_dataclass
from pathlib import PurePath
from types import CodeType, FunctionType, MethodType, ModuleType
from typing import Any, NamedTuple

import numpy
import torch
from torch import Tensor

LIBRARIES = frozenset({*sys.stdlib_module_names, "torch", "numpy", "llvmlite", "typing_extensions"})
PLAIN = frozenset({type(None), bool, int, complex, str, bytes, range, slice, type(...), type(NotImplemented), torch.dtype,
                   torch.device})
CHANGING = frozenset({list, dict, set})  # whose contents may become others
# What Python keeps in a class for itself, and what does not change what its functions compute.
ASIDE = frozenset({
    "__doc__", "__module__", "__qualname__", "__dict__", "__weakref__", "__annotations__", "__annotate_func__",
    "__annotations_cache__", "__dataclass_fields__", "__dataclass_params__", "__parameters__", "__orig_bases__",
    "__firstlineno__", "__static_attributes__", "__slotnames__", "_abc_impl"})
WRAPPED = (staticmethod, classmethod, MethodType)  # around a function, `__func__`
COMPILER = ("torch_radbp.jit.", "torch_radbp.threads.")  # modules that count like those of a library
MOST = 20_000  # definitions that are read


class Opaque(Exception):
    """Error: something whose meaning its source does not tell; the message names it."""


def fingerprint(*things: Any) -> str:
    """A digest of what functions, classes and values mean.

    Args:
        things: functions, classes, numbers, strings, dtypes, tensors, dataclasses, and tuples, lists and dicts of these.

    Raises:
        Opaque: if they reach something whose meaning cannot be told, such as a lock.
    """
    return hashlib.sha256("\n".join(definitions_reached(*things)[0]).encode()).hexdigest()


def definitions_reached(*things: Any) -> tuple[list[str], list[Any]]:
    """The text of things and of all that they reach, a line for each, and the functions, classes and objects among these.

    Args and Raises as for `fingerprint`.
    """
    named: list[Any] = []
    numbers: dict[int, int] = {}  # of these, by identity

    def line(defined: Definition) -> str:
        """A text whose references are numbers, by the order in which they are met first."""
        for thing in defined.references:
            if numbers.setdefault(id(thing), len(named)) == len(named):
                named.append(thing)
        return f"{defined.digest} {[numbers[id(thing)] for thing in defined.references]}"

    lines = [line(DefinitionReader().told(lambda reader: reader.words(things)))]
    for thing in named:  # grows meanwhile
        lines.append(line(definition(thing)))
        if len(lines) > MOST:
            raise Opaque(f"more than {MOST} functions and classes")
    return lines, named


class Definition(NamedTuple):
    """The text of a thing, in which other functions, classes and objects stand without their contents."""

    digest: str  # of the text
    references: tuple[Any, ...]  # to others, in their order
    lasting: bool  # whether the same text would be found as long as all that it was read from is the same object


class Remembered(NamedTuple):
    """The definition of a function or class, and what it was read from."""

    thing: Any  # kept alive, so that no other has its identity
    names: tuple[str, ...]
    values: tuple[Any, ...]
    definition: Definition


_remembered: dict[int, Remembered] = {}  # by identity


def definition(thing: Any) -> Definition:
    """The definition of a function, class or object; of the former two that of before, if all they name is the same.

    Most functions are reached from many others, and nothing of most is exchanged while the program runs.
    """
    if not isinstance(thing, (FunctionType, type)):
        return DefinitionReader().told(lambda reader: reader.object(thing))
    parts = mentioned_by(thing) if isinstance(thing, FunctionType) else meaningful_attributes(thing)
    names, values = tuple(parts), tuple(parts.values())
    known = _remembered.get(id(thing))
    if known is not None and known.names == names and all(map(operator.is_, known.values, values)):
        return known.definition
    found = DefinitionReader().told(lambda reader: reader.function(thing, parts) if isinstance(thing, FunctionType)
                                    else reader.type(thing, parts))
    if found.lasting:
        _remembered[id(thing)] = Remembered(thing, names, values, found)
    return found


def mentioned_by(function: FunctionType) -> dict[str, Any]:
    """A function's code and all that it refers to."""
    code = function.__code__
    if hasattr(function, "__wrapped__"):  # told by what it does with the function, but not what it remembers of it
        return {"(wrapped)": function.__wrapped__, "(code)": code}
    known, found = function.__globals__, {}
    mentioned = names(code)
    for name in mentioned:
        if name in known:
            found[name] = known[name]
        elif name in sys.modules and not is_library(name):  # imported inside
            found[name] = sys.modules[name]
    for module in [value for value in found.values() if isinstance(value, ModuleType)]:
        if not is_library(module.__name__):
            found |= {f"{module.__name__}.{name}": vars(module)[name] for name in mentioned if name in vars(module)}
    found["(code)"] = code
    for number, value in enumerate(function.__defaults__ or ()):
        found[f"(default {number})"] = value
    for name, value in (function.__kwdefaults__ or {}).items():
        found[f"(default {name})"] = value
    for number, cell in enumerate(function.__closure__ or ()):
        try:
            found[f"(closure {number})"] = cell.cell_contents
        except ValueError:  # empty so far
            found[f"(closure {number})"] = None
    return found


def meaningful_attributes(thing: type) -> dict[str, Any]:
    """A class's bases, and its attributes that change what functions compute."""
    bound = (FunctionType, property, functools.cached_property) if issubclass(thing, torch.nn.Module) else ()
    found = {name: part for name, part in vars(thing).items() if name not in ASIDE and not isinstance(part, bound)}
    defaults = found.pop("_field_defaults", {})  # of a NamedTuple
    return (found | {f"(default {name})": value for name, value in defaults.items()}
            | {f"(base {number})": base for number, base in enumerate(thing.__bases__)})


class DefinitionReader:
    """Describes a thing in text; notes to which functions, classes and objects it refers."""

    def __init__(self) -> None:
        self.references: list[Any] = []
        self.lasting = True

    def told(self, tell: Callable[[DefinitionReader], str]) -> Definition:
        """The definition of a thing whose text `tell` returns, with all that the text refers to."""
        text = tell(self)
        digest = hashlib.sha256(text.encode(errors="surrogatepass")).hexdigest()
        return Definition(digest, tuple(self.references), self.lasting)

    def name(self, thing: Any) -> str:
        """The sign that stands in a text for a thing that is defined elsewhere; the thing is noted as a reference."""
        self.references.append(thing)
        return "#"

    def words(self, value: Any) -> str:
        """Describes a value in text; functions, classes and objects in it are noted as references."""
        kind = type(value)
        if kind in PLAIN:
            return repr(value)
        if kind is float:
            return value.hex()
        if kind in CHANGING or isinstance(value, (Tensor, numpy.ndarray)):
            self.lasting = False
        if kind is tuple or kind is list:
            return f"{kind.__name__}({self.listed(value)})"
        if kind is dict:
            return f"dict({self.listed(value)}: {self.listed(value.values())})"
        if kind is set or kind is frozenset:
            return f"set({sorted(map(self.words, value))})"
        if kind is CodeType:
            return self.code(value)
        if kind is ModuleType:
            return f"module {value.__name__}"
        if kind in WRAPPED:
            return f"{kind.__name__} {self.words(value.__func__)}"
        if kind is property:
            return f"property({self.listed((value.fget, value.fset, value.fdel))})"
        if kind is functools.partial:
            return f"partial({self.listed((value.func, value.args, value.keywords))})"
        if kind is functools.cached_property:
            return f"cached {self.words(value.func)}"
        if isinstance(value, (Tensor, numpy.ndarray)):
            array = value.detach().cpu().numpy() if isinstance(value, Tensor) else value
            return f"array {array.dtype} {array.shape} {hashlib.sha256(array.tobytes()).hexdigest()}"
        if isinstance(value, (type, FunctionType)):
            return self.full_name(value) if in_library(value) else self.name(value)
        if isinstance(value, torch.nn.Module):
            raise Opaque(f"a module, {self.full_name(kind)}")
        if not in_library(kind):
            return self.name(value)
        if hasattr(value, "__wrapped__"):  # a memory, whose contents do not matter
            return f"remembered {self.words(value.__wrapped__)}"
        if kind.__module__ in ("typing", "types") or isinstance(value, (numpy.generic, PurePath)):
            return repr(value)
        if kind is re.Pattern:
            return f"pattern {value.pattern!r} {value.flags}"
        if hasattr(value, "__name__") or hasattr(value, "__objclass__") or kind.__name__ == "_tuplegetter":
            return f"{kind.__name__} {self.full_name(value)}"  # a function of a library in C, or an attribute's place
        raise Opaque(f"an object of {kind.__module__}.{kind.__qualname__}")

    def listed(self, values: Iterable) -> str:
        return ", ".join(map(self.words, values))

    def full_name(self, thing: Any) -> str:
        return f"{getattr(thing, '__module__', None)}.{getattr(thing, '__qualname__', None)}"

    def function(self, function: FunctionType, parts: dict[str, Any]) -> str:
        """Describes a function in text by `parts`: its code and all that it refers to, from `mentioned_by`."""
        return f"function {self.full_name(function)} {self.listed(parts)}: {self.listed(parts.values())}"

    def type(self, thing: type, parts: dict[str, Any]) -> str:
        """Describes a class in text by `parts`: its bases, and attributes that matter, from `meaningful_attributes`."""
        return f"class {self.full_name(thing)} {self.listed(parts)}: {self.listed(parts.values())}"

    def object(self, thing: Any) -> str:
        """Describes an object in text by its class and attributes."""
        if isinstance(thing, enum.Enum):
            return f"{self.full_name(type(thing))}.{thing.name} {self.words(thing.value)}"
        if is_dataclass(thing):
            state = {field.name: getattr(thing, field.name) for field in fields(thing)}
        elif isinstance(thing, tuple):
            state = tuple(thing)
        elif type(thing).__module__ and hasattr(thing, "__dict__"):
            state = dict(sorted(vars(thing).items()))
        else:
            raise Opaque(f"an object of {self.full_name(type(thing))}")
        return f"object of {self.words(type(thing))}: {self.words(state)}"

    def code(self, code: CodeType) -> str:
        """The text of a code object, independent of its place in the source."""
        return f"code {instructions(code)} {self.words(code.co_consts)}"


@functools.cache
def instructions(code: CodeType) -> str:
    """The text of a code object's instructions, without constants."""
    return repr((code.co_code, code.co_argcount, code.co_posonlyargcount, code.co_kwonlyargcount, code.co_flags,
                 code.co_names, code.co_varnames, code.co_freevars, code.co_cellvars))


@functools.cache
def names(code: CodeType) -> tuple[str, ...]:
    """The names that a function and its inner functions refer to, each once; dunder names are left out."""
    inner = [name for constant in code.co_consts if isinstance(constant, CodeType) for name in names(constant)]
    return tuple(name for name in dict.fromkeys([*code.co_names, *inner]) if not name.startswith("__"))


@functools.cache
def is_library(module: str) -> bool:
    """True if a module belongs to a library, whose version stands for its contents."""
    return module.partition(".")[0] in LIBRARIES or module.startswith(COMPILER)


def in_library(thing: Any) -> bool:
    """True if a function or class belongs to a library whose version stands for its contents."""
    return is_library(getattr(thing, "__module__", None) or "builtins")
