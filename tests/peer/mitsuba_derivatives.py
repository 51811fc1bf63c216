"""Mitsuba's side of the derivatives of `derivative_subjects`: by Dr.Jit's forward mode, and by differences of parameters
that Mitsuba does not differentiate. They are stored in ``reference/derivatives.npz``.

    python -m tests.peer.mitsuba_derivatives                # all, needs mitsuba==3.9.1 and its LLVM variant; some minutes
    python -m tests.peer.mitsuba_derivatives plastic thin   # these only
"""

from __future__ import annotations

import sys
import tempfile
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from benchmarks.peers import mitsuba_for

from .derivative_subjects import PLACES, SUBJECTS, WI, WO, Subject, objects, tangent
from .mitsuba_images import REFERENCE
from .our_derivatives import parameters, subject_of

FILE = REFERENCE / "derivatives.npz"
KEPT_BITS = 14  # of the 24 of a float32's mantissa, so that the file is small: right to 6e-5
STEP = 4e-3  # of differences
KINK = 5e-4  # by how much differences of two steps may differ, relative to the largest: else something jumps between them
# Tables of what a rough coat lets through are computed from these, by sums that ripple: steps must be so many times longer.
DETACHED = {"roughplastic": {"alpha": 1, "eta": 5}}



class Peer:
    """A subject in Mitsuba."""

    def __init__(self, subject: Subject, folder: Path, mi=None):
        self.mi = mitsuba_for("cpu") if mi is None else mi
        import drjit as dr

        self.dr, self.asked = dr, subject.asked
        description = self.translated(objects(subject, folder))
        if subject.asked == "bsdf":
            self.subject = self.mi.load_dict(description)
        else:
            self.subject = self.mi.load_dict({"type": "scene", **description})
        self.is_mask, self.kinds = description.get("type") == "mask", repr(subject.description)
        self.parameters = self.mi.traverse(self.subject)
        self.wi, self.wo, self.p, self.towards = (
            self.vector(array) for array in (PLACES.wi, PLACES.wo, PLACES.p, PLACES.towards))

    def translated(self, value: Any, key: str = "") -> Any:
        """A description with Mitsuba's types of transforms and images."""
        if isinstance(value, dict):
            return {name: self.translated(item, name) for name, item in value.items()}
        if not isinstance(value, np.ndarray):
            return value
        if value.shape == (4, 4):
            return self.mi.ScalarTransform4f(value)
        kind = self.mi.Bitmap if key == "bitmap" else self.mi.TensorXf
        return kind(np.ascontiguousarray(value, dtype=np.float32))

    def vector(self, array: np.ndarray):
        """An (N, 3) array as lanes."""
        return self.mi.Vector3f(*(self.mi.Float(column.copy()) for column in array.T))

    # -- Answers -----------------------------------------------------------------------------------------------------------

    def answers(self) -> list:
        """The columns that `COLUMNS` names."""
        return self.of_material() if self.asked == "bsdf" else list(getattr(self, f"of_{self.asked}")())

    def of_material(self) -> list:
        mi, dr, context = self.mi, self.dr, self.mi.BSDFContext()
        si = dr.zeros(mi.SurfaceInteraction3f, len(PLACES.wi))
        si.wi, si.n, si.sh_frame = self.wi, mi.Normal3f(0, 0, 1), mi.Frame3f(mi.Vector3f(0, 0, 1))
        si.uv = mi.Point2f(*(mi.Float(column.copy()) for column in PLACES.uv.T))
        si.dp_du, si.dp_dv = mi.Vector3f(1, 0, 0), mi.Vector3f(0, 1, 0)
        value, density = self.subject.eval_pdf(context, si, self.wo)
        choose, u, v = (mi.Float(column.copy()) for column in PLACES.random.T)
        sample, weight = self.subject.sample(context, si, choose, mi.Point2f(u, v))
        is_delta = mi.has_flag(sample.sampled_type, mi.BSDFFlags.Delta) & (dr.max(weight) > 0)
        # Of masks both are attached to the opacity, of which the weight alone should be, as it is of other materials.
        chance = dr.detach(sample.pdf) if self.is_mask else sample.pdf
        weight = dr.select(is_delta, weight * chance, 0)
        return [*value, density, *weight, *dr.select(is_delta, sample.wo, 0)]

    def of_surround(self):
        si = self.dr.zeros(self.mi.SurfaceInteraction3f, len(PLACES.wi))
        si.wi = -self.wi
        return self.subject.environment().eval(si)

    def of_lamp(self):
        si = self.dr.zeros(self.mi.Interaction3f, len(PLACES.p))
        si.p = self.p
        sample, radiance = self.subject.emitters()[0].sample_direction(si, self.mi.Point2f(0.5))
        return [*radiance, *sample.d]

    def of_surface(self):
        si = self.subject.ray_intersect(self.mi.Ray3f(self.mi.Point3f(self.p), self.towards))
        return self.dr.select(si.is_valid(), self.subject.emitters()[0].eval(si), 0)

    # -- Derivatives -------------------------------------------------------------------------------------------------------

    def derivatives(self, names: Iterable[str]) -> dict[str, np.ndarray]:
        """By parameter, and for materials by direction, the derivatives of all answers, (N, C).

        Those of parameters that are not differentiable in Mitsuba are differences, NaN at places where there is none.

        Args:
            names: of the parameters; those that Mitsuba does not have are left out.
        """
        found = {}
        for name in names:
            if name not in self.parameters:
                continue
            value = type(self.parameters[name])(self.parameters[name])  # a copy: what is put is written into the old one
            answers = self.parameter_moved(name)
            found[name] = self.forward(answers) if self.is_differentiable(name) else self.differences(
                answers, STEP * (self.detached(name) or 1))
            self.put(name, value)
        if self.asked == "bsdf":
            found |= {WI: self.forward(self.direction_moved("wi", PLACES.d_wi)),
                      WO: self.forward(self.direction_moved("wo", PLACES.d_wo))}
        return found

    def is_differentiable(self, name: str) -> bool:
        """True for numbers of Dr.Jit and transforms of such, unless something that is computed from them is detached."""
        return self.dr.is_diff_v(numbers_of(self.parameters[name])) and not self.detached(name)

    def detached(self, name: str) -> int:
        """What `DETACHED` says of a parameter; 0: nothing."""
        last = name.rpartition(".")[2]
        return max(names.get(last, 0) if kind in self.kinds else 0 for kind, names in DETACHED.items())

    def put(self, name: str, value) -> None:
        """Sets a parameter."""
        self.parameters[name] = value
        self.parameters.update()

    def parameter_moved(self, name: str) -> Callable[[Any], list]:
        """The answers as a function of a step of a parameter along its tangent."""
        value = self.parameters[name]
        build, start = type(value), numbers_of(value)
        start = type(start)(start)
        along = type(start)(self.tangent(name, np.array(start, dtype=float)))

        def answers(step) -> list:
            self.put(name, build(start + step * along))
            return self.answers()

        return answers

    def tangent(self, name: str, value: np.ndarray):
        """The tangent that belongs to Mitsuba's value of a parameter, as what its type is made from."""
        value = value.squeeze()
        if value.shape == (3, 3):  # the 2D affine part of a transform
            return tangent(name, np.eye(4))[[0, 1, 3]][:, [0, 1, 3]]
        if name.endswith("data") and self.asked == "surround":  # with the columns beyond both ends of an image
            return np.pad(tangent(name, value[:, 1:-1]), ((0, 0), (1, 1), (0, 0)), mode="wrap").astype(np.float32)
        found = tangent(name, value).astype(np.float32)
        return found if found.ndim > 1 else found.tolist()

    def direction_moved(self, attribute: str, along: np.ndarray) -> Callable[[Any], list]:
        """The answers as a function of a step of directions along their tangents."""
        start, along = getattr(self, attribute), self.vector(along)

        def answers(step) -> list:
            setattr(self, attribute, start + step * along)
            found = self.answers()
            setattr(self, attribute, start)
            return found

        return answers

    def forward(self, answers: Callable[[Any], list]) -> np.ndarray:
        """(N, C) the derivatives of the answers by the step at zero."""
        step = self.mi.Float(0)
        self.dr.enable_grad(step)
        found = answers(step)
        self.dr.set_grad(step, 1)
        attached = [column for column in found if self.dr.grad_enabled(column)]
        if attached:
            self.dr.forward_to(*attached, flags=self.dr.ADFlag.ClearEdges)  # an answer may be a part of another
        return stacked([self.dr.grad(column) for column in found])

    def differences(self, answers: Callable[[float], list], length: float) -> np.ndarray:
        """(N, C) the same by differences of fourth order; NaN at places where those of other steps are others.

        Args:
            answers: as functions of a step.
            length: of the steps.
        """
        at = {k: stacked(answers(k * length)) for k in (-4, -2, -1, 0, 1, 2, 4)}
        narrow, middle, wide = ((at[k] - at[-k]) / (2 * k * length) for k in (1, 2, 4))
        found, other = (4 * narrow - middle) / 3, (4 * middle - wide) / 3
        bends = [(at[k] - 2 * at[0] + at[-k]) / (k * k * length) for k in (1, 2)]
        differing = np.maximum(abs(found - other), abs(bends[0] - bends[1]))
        largest = np.where(differing < 0.1 * abs(found), abs(found), 0).max(0)  # of those that are derivatives
        found[(differing > KINK * largest).any(1)] = np.nan
        return found


def numbers_of(value):
    """What a parameter is made of: of a transform its matrix."""
    return value.matrix if "Transform" in type(value).__name__ else value


def stacked(columns: list) -> np.ndarray:
    """(N, C) of C columns, float64."""
    return np.stack([np.array(column, dtype=np.float64) * np.ones(len(PLACES.wi)) for column in columns], 1)


class Reference(NamedTuple):
    """What is stored of a subject."""

    digest: str
    names: list[str]
    """Of the parameters and directions that move."""
    derivatives: np.ndarray
    """(R, N, C) of the answers, for each; NaN where there is none."""
    differences: np.ndarray
    """(R,) bool: these are differences."""


def reference(subject: Subject) -> Reference:
    """Asks Mitsuba."""
    with tempfile.TemporaryDirectory() as folder:
        names = parameters(subject_of(subject, Path(folder)))
        peer = Peer(subject, Path(folder))
        found = peer.derivatives(names)
        differences = [name in peer.parameters and not peer.is_differentiable(name) for name in found]
    return Reference(subject.digest(), list(found), rounded(np.stack(list(found.values()))), np.array(differences))


def rounded(array: np.ndarray) -> np.ndarray:
    """float32 with the last bits of its mantissa zero, which are compressed to nothing."""
    mantissa, exponent = np.frexp(array)
    return np.ldexp(np.round(mantissa * 2.0**KEPT_BITS) / 2.0**KEPT_BITS, exponent).astype(np.float32)


def store(names: Iterable[str]) -> None:
    """Asks Mitsuba for some of `SUBJECTS` and writes what is stored anew; what is stored of others stays."""
    arrays = {}
    if FILE.exists():
        with np.load(FILE) as stored:
            arrays = {key: stored[key] for key in stored if key.rpartition("/")[0] in SUBJECTS}
    for name in names:
        found = reference(SUBJECTS[name])
        arrays |= {f"{name}/{part}": value for part, value in found._asdict().items()}
        print(f"{name}: {len(found.names)} derivatives, {found.differences.sum()} by differences", flush=True)
    np.savez_compressed(FILE, **arrays)


def load_reference(name: str) -> Reference:
    """What is stored of one of `SUBJECTS`.

    Raises:
        ValueError: if the subject or the places have changed since.
    """
    with np.load(FILE) as stored:
        found = Reference(*(stored[f"{name}/{part}"] for part in Reference._fields))
    if str(found.digest) != SUBJECTS[name].digest():
        raise ValueError(f"{FILE.name} belongs to another version of {name!r}; run python -m tests.peer.mitsuba_derivatives")
    return found._replace(names=found.names.tolist(), derivatives=found.derivatives.astype(np.float64))


if __name__ == "__main__":
    store(sys.argv[1:] or SUBJECTS)
