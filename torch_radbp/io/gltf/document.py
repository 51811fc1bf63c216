"""Checked access to the values of a glTF document, with their places for messages."""

from __future__ import annotations

import math
from typing import Any

from torch_radbp.formats.leniency import Repairs
from torch_radbp.io.values.attribute_values import value_text
from torch_radbp.plugin import SceneError, nearest

REQUIRED: Any = object()  # in the place of a default: there is none


class GltfWarning(UserWarning):
    """A glTF file was read or written with losses: the message lists all that the other side cannot say,
    each kind once.

    `load` warns of what it does not read of a file, and of the camera or light that it adds to one without; `save` of what
    glTF has no words for. With `strict=True` either raises a `SceneError` instead.
    """


class Losses(Repairs):
    """Collects, by kind, what is left out or changed between a scene and a glTF file, for one warning."""


def without_nulls(document: dict[str, Any], losses: Losses) -> dict[str, Any]:
    """Removes null entries, which glTF does not have, from a document; `extras` stay as they are."""
    waiting: list[tuple[str, Any]] = [("", document)]
    while waiting:
        place, value = waiting.pop()
        if isinstance(value, list):
            waiting += [(f"{place}[{number}]", item) for number, item in enumerate(value)]
        elif isinstance(value, dict):
            for name in [name for name, item in value.items() if item is None and name != "extras"]:
                losses.add(f"{place}.{name:.80}".lstrip("."), "null is read as if nothing was given")
                del value[name]
            waiting += [(f"{place}.{name:.80}".lstrip("."), item) for name, item in value.items() if name != "extras"]
    return document


class DocumentPart:
    """An object in a glTF document, such as `materials[2] 'gold'`."""

    def __init__(self, file: str, place: str, value: Any):
        self.file, self.place, self.value = file, place, value
        if not isinstance(value, dict):
            raise self.fail(f"must be an object, got {value_text(value)}")

    def fail(self, message: str) -> SceneError:
        """An error about this object, to be raised."""
        return SceneError(f"{self.file}: {self.place}: {message}" if self.place else f"{self.file}: {message}")

    def inside(self, name: str) -> str:
        """The place of the entry `name` in the document, for messages."""
        return f"{self.place}.{name}" if self.place else name

    def has(self, name: str) -> bool:
        return name in self.value

    def entry(self, name: str, default: Any) -> Any:
        """An entry as it is in the document, or its default."""
        if name not in self.value and default is REQUIRED:
            raise self.fail(f"{name!r} is missing")
        return self.value.get(name, default)

    def number(self, name: str, default: Any = REQUIRED, low: float = -math.inf, high: float = math.inf) -> float:
        """Reads a number from `low` to `high`."""
        value = self.entry(name, default)
        return default if value is default else self.checked(name, value, low, high)

    def checked(self, name: str, value: Any, low: float = -math.inf, high: float = math.inf) -> float:
        """Converts `value` to a float within bounds."""
        if isinstance(value, bool) or not isinstance(value, (int, float)):
            raise self.fail(f"{name} must be a number, got {value_text(value)}")
        if not (low <= value <= high and abs(value) < 1e300):
            bounds = "finite" if (low, high) == (-math.inf, math.inf) else f"in [{low:g}, {high:g}]"
            raise self.fail(f"{name} must be {bounds}, got {value_text(value)}")
        return float(value)

    def numbers(self, name: str, count: int, default: Any = REQUIRED, low: float = -math.inf,
                high: float = math.inf) -> list[float]:
        """Reads a list of `count` numbers."""
        value = self.entry(name, default)
        if not isinstance(value, (list, tuple)) or len(value) != count:
            raise self.fail(f"{name} must be a list of {count} numbers, got {value_text(value)}")
        return [self.checked(name, item, low, high) for item in value]

    def integer(self, name: str, default: Any = REQUIRED, low: int = 0, high: int = 2**53) -> int:
        """Reads an integer from `low` to `high`; some writers give it as 3.0."""
        value = self.entry(name, default)
        if value is default:
            return default
        if isinstance(value, bool) or not isinstance(value, (int, float)) or not low <= value <= high or value != int(value):
            raise self.fail(f"{name} must be an integer from {low} to {high}, got {value_text(value)}")
        return int(value)

    def text(self, name: str, default: Any = REQUIRED) -> str:
        """Reads a string."""
        value = self.entry(name, default)
        if value is not default and not isinstance(value, str):
            raise self.fail(f"{name} must be a string, got {value_text(value)}")
        return value

    def choice(self, name: str, choices: dict[Any, Any], default: Any = REQUIRED) -> Any:
        """Looks the entry up in the dict `choices`."""
        value = self.entry(name, default)
        try:
            return choices[value]
        except (KeyError, TypeError):
            raise self.fail(f"{name} {value_text(value)} is not known; {nearest(str(value), map(str, choices))}") from None

    def flag(self, name: str, default: bool = False) -> bool:
        """Reads a boolean."""
        value = self.entry(name, default)
        if not isinstance(value, bool):
            raise self.fail(f"{name} must be true or false, got {value_text(value)}")
        return value

    def part(self, name: str) -> DocumentPart:
        """The nested object `name`, without entries if it is missing."""
        return DocumentPart(self.file, self.inside(name), self.entry(name, {}))

    def parts(self, name: str) -> list[DocumentPart]:
        """The nested objects in a list."""
        return [DocumentPart(self.file, f"{self.inside(name)}[{number}]", item)
                for number, item in enumerate(self.items(name))]

    def items(self, name: str) -> list[Any]:
        """Reads a list; the empty one if it is missing."""
        value = self.entry(name, [])
        if not isinstance(value, list):
            raise self.fail(f"{name} must be a list, got {value_text(value)}")
        return value

    def extension(self, name: str) -> DocumentPart | None:
        """The object in `extensions` of the extension `name`, or None."""
        extensions = self.part("extensions")
        return extensions.part(name) if extensions.has(name) else None


class Document(DocumentPart):
    """The root object of a glTF document."""

    def __init__(self, file: str, value: Any):
        super().__init__(file, "", value)
        version = self.part("asset").text("version")
        if version.split(".")[0] != "2":
            raise self.fail(f"glTF version {version!r} is not supported; supported: 2.0")

    def of(self, name: str, index: int, user: DocumentPart, entry: str) -> DocumentPart:
        """The object number `index` of the list `name`, to which the entry of another object refers."""
        items = self.items(name)
        if not 0 <= index < len(items):
            last = f"0 to {len(items) - 1}" if items else "none"
            raise user.fail(f"{entry} {index} does not exist; the document has {name} {last}")
        part = DocumentPart(self.file, f"{name}[{index}]", items[index])
        title = part.text("name", "")
        return DocumentPart(self.file, f"{part.place} {value_text(title)}", part.value) if title else part

    def referred(self, name: str, user: DocumentPart, entry: str, default: Any = REQUIRED) -> DocumentPart | None:
        """The object of the list `name` to which an entry of `user` refers; None if there is no such entry."""
        index = user.integer(entry, default)
        return None if index is None else self.of(name, index, user, entry)
