"""What the tables of a recipe are made of: tables without unknown keys, paths, and numbers of strict types."""

import os
from pathlib import Path
from typing import Annotated, Any

from pydantic import AfterValidator, BaseModel, BeforeValidator, ConfigDict, Field, PlainSerializer, model_validator

from torch_radbp.plugin import nearest

LARGEST = 1e30  # a number that float32 holds, and its products with other sensible ones too


class Table(BaseModel):
    """A TOML table whose unknown keys are refused with the nearest known one."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)

    @model_validator(mode="before")
    @classmethod
    def _refuse_unknown_keys(cls, data: Any) -> Any:
        if not isinstance(data, dict):
            raise ValueError(f"expected a table, got {data!r}")
        for key in data:
            if key not in cls.model_fields:
                raise ValueError(f"unknown key {key!r}; {nearest(key, cls.model_fields)}")
        return data


def _resolve(path: Path, info) -> Path:
    folder, given = info.context["base_dir"], path
    path = Path(os.path.abspath(folder / given))
    if not info.context["allow_outside"] and not Path(os.path.realpath(path)).is_relative_to(os.path.realpath(folder)):
        raise ValueError(f"{str(given)[:80]!r} leads out of the recipe's folder {folder}; if you trust the recipe, pass "
                         "--allow-outside (in Python allow_outside=True)")
    if not os.path.isfile(path):  # unlike Path.is_file, it raises nothing for names that are too long
        what = "is a folder, not a file" if os.path.isdir(path) else "is not an ordinary file"
        raise ValueError(f"{path}: {what}" if os.path.exists(path) else f"no such file: {path}")
    return path


def _relative(path: Path, info) -> str:
    base_dir = (info.context or {}).get("base_dir")
    return Path(os.path.relpath(path, base_dir) if base_dir else path).as_posix()


# A file named by a recipe: relative to the recipe when read, relative to the copy when written.
RecipePath = Annotated[Path, AfterValidator(_resolve), PlainSerializer(_relative)]


def _check_value(value: Any) -> Any:
    if isinstance(value, bool) or not isinstance(value, (int, float, list, str, Path)):
        raise ValueError(f"expected a number, a list of numbers or the path of an image, got {value!r}")
    return value


def _check_magnitude(value: float) -> float:
    if abs(value) > LARGEST:
        raise ValueError(f"must be from -{LARGEST:g} to {LARGEST:g}, got {value:g}")
    return value


# The value of a parameter: one number for all entries, nested lists, or an image file.
Value = Annotated[float | list[float] | list[list[float]] | RecipePath, BeforeValidator(_check_value)]
# Strict: `steps = true` and `spp = "4"` are mistakes, not 1 and 4.
Whole = Annotated[int, Field(strict=True, lt=2**31)]
Whole64 = Annotated[int, Field(strict=True, lt=2**63)]
Number = Annotated[float, Field(strict=True), AfterValidator(_check_magnitude)]
Switch = Annotated[bool, Field(strict=True)]
Fraction = Annotated[Number, Field(ge=0, lt=1)]
Positive = Annotated[Number, Field(gt=0)]
Count = Annotated[Whole, Field(ge=1)]
