"""Reads Wavefront OBJ files: malformed lines are errors, lines that are left out or repaired are warnings.

An own reader, since trimesh's is silent (texture indices out of range drop all coordinates, faces of two corners vanish, an
index of 0 counts as 1) and takes 4.0 s and 741 MB for a million triangles with normals and uv where this one takes 2.3 s and
250 MB (`python -m benchmarks.mesh_files`).

All objects, groups and materials become one mesh, as in Mitsuba, and lines and points (`l`, `p`) are no surface. Where some
faces have normals or uv and others none, for which Mitsuba 3.9 leaves memory unset, the others have normals made from the
triangles around, and the uv (0, 0).

Reference: the Object Files (.obj) chapter of the Wavefront Advanced Visualizer manual, appendix B1.
"""

from __future__ import annotations

from typing import BinaryIO, NamedTuple

import numpy as np

from torch_radbp.formats.leniency import Repairs
from torch_radbp.formats.mesh_arrays import FEW_CORNERS, MeshArrays, fans, usable_normals, usable_uv, used_by
from torch_radbp.formats.text_lines import Lines, decimals, read_lines
from torch_radbp.plugin import nearest

IGNORED = frozenset("o g s mg l p usemtl mtllib usemap maplib lod bevel c_interp d_interp shadow_obj trace_obj".split())
# Statements of free-form geometry, as Rhino writes it; these three are what is left out with them.
FREE_FORM = frozenset("curv curv2 surf".split())
OF_FREE_FORM = frozenset("vp cstype deg bmat step parm trim hole scrv sp con end res ctech stech".split())
COUNTS = {"v": (3, 4, 6, 7), "vt": (2, 3), "vn": (3,)}  # x y z [w] [r g b]; u v [w]; x y z
WIDTHS = {"v": 3, "vt": 2, "vn": 3}  # the numbers that are kept
NOUNS = {"v": "vertex", "vt": "texture coordinate", "vn": "normal"}
LACKING = {"vt": "corners without a texture coordinate are read at (0, 0)",
           "vn": "corners without a normal have one made from the triangles around"}
SLASH = ord("/")
LARGEST_INDEX = 2**31


class Polygons(NamedTuple):
    """The polygons of an OBJ file, from its `f` lines; indices from 0."""

    counts: np.ndarray  # (P,) int32 corners of each
    lines: np.ndarray  # (P,) int32 line of each
    corners: dict[str, np.ndarray]  # "v", "vt", "vn" -> (C,) int32 index of each corner, or -1 where it has none


def read_obj(file: BinaryIO, place: str, want_normals: bool = True) -> MeshArrays:
    """The mesh in an OBJ file; vertices in the order in which faces mention them with their normals and uv, as in Mitsuba.

    Args:
        file: opened in binary mode.
        place: its name, for messages.
        want_normals: False leaves out the file's normals, whatever they are.

    Raises:
        ValueError: names file and line of what is malformed or out of range, or of a position that is not finite.
    """
    rows: dict[str, list[np.ndarray]] = {keyword: [np.empty((0, width))] for keyword, width in WIDTHS.items()}
    places: dict[str, list[np.ndarray]] = {keyword: [] for keyword in WIDTHS}
    seen, wanted = dict.fromkeys(WIDTHS, 0), [keyword for keyword in WIDTHS if want_normals or keyword != "vn"]
    faces = []
    for lines in read_lines(file, place, comments=True):
        kinds = _kinds(lines, place)
        for keyword in wanted:
            chosen = np.flatnonzero(kinds == keyword.encode())
            if len(chosen):
                rows[keyword].append(_rows(lines, chosen, keyword, place))
                places[keyword].append(lines.numbers[chosen])
        chosen = np.flatnonzero(kinds == b"f")
        if len(chosen):
            before = {keyword: seen[keyword] + np.cumsum(kinds == keyword.encode())[chosen] for keyword in WIDTHS}
            faces.append(_faces(lines, chosen, before, place))
        for keyword in WIDTHS:
            seen[keyword] += int(np.count_nonzero(kinds == keyword.encode()))
    merged = _merged(faces) if faces else None
    if merged is None or not len(merged.counts):
        raise ValueError(f"{place}: the mesh has {seen['v']} vertices and no faces (lines like \"f 1 2 3\")")
    values = {keyword: np.concatenate(blocks) for keyword, blocks in rows.items()}
    if not want_normals:
        merged.corners["vn"][:] = -1
    for keyword in WIDTHS:
        _check_range(merged, keyword, len(values[keyword]), place)
    for keyword, usable in (("vt", usable_uv), ("vn", usable_normals)):
        index = merged.corners[keyword]
        if (index >= 0).any():
            used, numbers = used_by(index[index >= 0], len(values[keyword])), np.concatenate(places[keyword])
            values[keyword] = usable(values[keyword], used, lambda row, numbers=numbers: f"{place}, line {numbers[row]}")
            values[keyword] = _completed(merged, keyword, values[keyword], place)
    return _mesh(merged, values)


def _kinds(lines: Lines, place: str) -> np.ndarray:
    """(L,) the keyword of each line: b"v", b"vt", b"vn", b"f", or b"" for an ignored one."""
    words = lines.first[:-1]
    begin, length = lines.starts[words], lines.ends[words] - lines.starts[words]
    letters = lines.text.take(begin[:, None] + np.arange(2), mode="clip")
    letters[length == 1, 1] = 0
    kinds = letters.reshape(-1).view("S2")
    geometry = ((length == 1) & np.isin(kinds, (b"v", b"f"))) | ((length == 2) & np.isin(kinds, (b"vt", b"vn")))
    for index in np.flatnonzero(~geometry):
        word = words[index]
        keyword = lines.text[lines.starts[word]:lines.ends[word]].tobytes().decode("utf-8", "backslashreplace")
        if keyword in FREE_FORM:
            with Repairs() as repairs:
                repairs.add(f"{place}, line {lines.numbers[index]}", "a curve or free-form surface is left out")
        elif keyword not in IGNORED and keyword not in OF_FREE_FORM:
            raise ValueError(f"{place}, line {lines.numbers[index]}: {lines.word(word)} does not begin a line that is "
                             f"supported; {nearest(keyword[:40], [*WIDTHS, 'f', *IGNORED])}")
    return np.where(geometry, kinds, b"")


def _words_after_keyword(lines: Lines, chosen: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The words of some lines without their keywords, and the number of words in each."""
    counts = lines.first[chosen + 1] - lines.first[chosen] - 1
    begin = np.repeat(lines.first[chosen] + 1 - (np.cumsum(counts) - counts), counts)
    return begin + np.arange(counts.sum()), counts


def _rows(lines: Lines, chosen: np.ndarray, keyword: str, place: str) -> np.ndarray:
    """(N, width) the numbers of the `keyword` lines; numbers beyond the width are checked and dropped."""
    words, counts = _words_after_keyword(lines, chosen)
    bad = ~np.isin(counts, COUNTS[keyword])
    if bad.any():
        index = int(np.argmax(bad))
        wanted = " or ".join(map(str, COUNTS[keyword]))
        raise ValueError(f"{place}, line {lines.numbers[chosen[index]]}: a {NOUNS[keyword]} ({keyword}) has {wanted} "
                         f"numbers, got {counts[index]}")
    values = lines.values(words, place, finite=keyword == "v")
    return values[(np.cumsum(counts) - counts)[:, None] + np.arange(WIDTHS[keyword])]


def _faces(lines: Lines, chosen: np.ndarray, before: dict[str, np.ndarray], place: str) -> Polygons:
    """Parses the `f` lines among `lines`; `before`: the number of rows of each kind before each, for relative indices."""
    words, counts = _words_after_keyword(lines, chosen)
    whole = counts >= 3
    if not whole.all():
        with Repairs() as repairs:
            repairs.add_rows(lines.numbers[chosen[~whole]].tolist(), lambda line: f"{place}, line {line}", FEW_CORNERS)
        chosen, before = chosen[whole], {keyword: rows[whole] for keyword, rows in before.items()}
        words, counts = _words_after_keyword(lines, chosen)
    # Divide the corners at their slashes: the parts of corner i are first[i] to last[i].
    starts, ends = lines.starts[words], lines.ends[words]
    is_slash = lines.text == SLASH
    edges = np.flatnonzero(np.diff((lines.text > 32) & ~is_slash, prepend=False, append=False))
    parts = lines._replace(starts=edges[0::2], ends=edges[1::2])
    first = np.searchsorted(parts.starts, starts)
    last = np.searchsorted(parts.starts, ends) - 1
    # Tell the four forms by the numbers of parts and slashes; a slash at either end belongs to none of them.
    slash_at = np.flatnonzero(is_slash)
    slashes = np.searchsorted(slash_at, ends) - np.searchsorted(slash_at, starts)
    number = last - first + 1
    whole = (number > 0) & ~is_slash[starts] & ~is_slash[ends - 1]
    good = whole & (((number == slashes + 1) & (number <= 3)) | ((number == 2) & (slashes == 2)))
    if not good.all():
        word = words[np.argmin(good)]
        raise ValueError(f"{place}, line {lines.line_of_word(word)}: a corner of a face is v, v/vt, v//vn or v/vt/vn, got "
                         f"{lines.word(word)}")
    # Read the part that is the index of each kind.
    index_of = {"v": first, "vt": np.where((number >= 2) & (slashes == number - 1), first + 1, -1),
                "vn": np.where(slashes == 2, last, -1)}
    corners = {}
    for keyword, part in index_of.items():
        given = np.flatnonzero(part >= 0)
        result = np.full(len(words), -1, np.int32)
        if len(given):
            result[given] = _indices(parts, part[given], lines, words[given], place, keyword,
                                     np.repeat(before[keyword], counts)[given])
        corners[keyword] = result
    return Polygons(counts.astype(np.int32), lines.numbers[chosen].astype(np.int32), corners)


def _indices(parts: Lines, numbers: np.ndarray, lines: Lines, words: np.ndarray, place: str, keyword: str,
             before: np.ndarray) -> np.ndarray:
    """(N,) indices from 0; negative ones, -1 for the last row before the line, are resolved.

    Args:
        parts: the words between blanks and slashes; `numbers` are those with the indices.
        lines: the words between blanks; `words` are the corners that the indices belong to.
        before: (N,) how many rows of this kind come before the line.
    """
    values, valid = decimals(parts.text, parts.starts[numbers], parts.ends[numbers])
    valid &= (values == np.floor(values)) & (values != 0) & (np.abs(values) < LARGEST_INDEX)
    if not valid.all():
        word = words[np.argmin(valid)]
        raise ValueError(f"{place}, line {lines.line_of_word(word)}: {NOUNS[keyword]} indices are integers from 1, or "
                         f"relative ones from -1, got {lines.word(word)}")
    index = values.astype(np.int64)
    index = np.where(index > 0, index - 1, before + index)
    if (index < 0).any():
        where = int(np.argmin(index))
        raise ValueError(f"{place}, line {lines.line_of_word(words[where])}: the relative {NOUNS[keyword]} index in "
                         f"{lines.word(words[where])} is out of range, {before[where]} come before this line")
    return index


def _merged(faces: list[Polygons]) -> Polygons:
    """Joins the polygons of all blocks of lines of a file."""
    counts, lines, corners = zip(*faces, strict=True)
    return Polygons(np.concatenate(counts), np.concatenate(lines),
                    {keyword: np.concatenate([block[keyword] for block in corners]) for keyword in WIDTHS})


def _check_range(faces: Polygons, keyword: str, count: int, place: str) -> None:
    """Raises ValueError if an index is `count` or greater."""
    index = faces.corners[keyword]
    if index.max() >= count:
        first = int(np.argmax(index >= count))
        line = int(np.repeat(faces.lines, faces.counts)[first])
        raise ValueError(f"{place}, line {line}: the {NOUNS[keyword]} index {index[first] + 1} is out of range, the file "
                         f"has {count} ({keyword})")


def _completed(faces: Polygons, keyword: str, values: np.ndarray, place: str) -> np.ndarray:
    """`values` with a row of zeros added, to which corners without an index are set; warns of their faces."""
    index = faces.corners[keyword]
    lacking = index < 0
    if not lacking.any():
        return values
    with Repairs() as repairs:
        rows = np.flatnonzero(np.maximum.reduceat(lacking, np.cumsum(faces.counts) - faces.counts))
        repairs.add_rows(rows.tolist(), lambda row: f"{place}, line {faces.lines[row]}", LACKING[keyword])
    index[lacking] = len(values)
    return np.concatenate([values, np.zeros((1, values.shape[1]))])


def _mesh(faces: Polygons, values: dict[str, np.ndarray]) -> MeshArrays:
    """The mesh with one vertex for each combination of position, normal and uv, in the order of first use."""
    vertex = faces.corners["v"]
    for keyword in ("vt", "vn"):
        if (faces.corners[keyword] >= 0).any():
            vertex = _pairs(vertex, faces.corners[keyword])
    corner = np.arange(len(vertex), dtype=np.int32)
    first = np.empty(vertex.max() + 1, np.int32)
    first[vertex[::-1]] = corner[::-1]  # of several values for one entry the last is kept
    is_first = first[vertex] == corner
    numbered = (np.cumsum(is_first) - 1)[first[vertex]]  # int64
    columns = {keyword: values[keyword][index[is_first]] if (index >= 0).any() else None
               for keyword, index in faces.corners.items()}
    return MeshArrays(columns["v"], fans(numbered, faces.counts), columns["vn"], columns["vt"])


def _pairs(first: np.ndarray, second: np.ndarray) -> np.ndarray:
    """(C,) a number for each pair, equal for equal pairs."""
    partner = np.empty(first.max() + 1, second.dtype)
    partner[first] = second
    if (partner[first] == second).all():  # the second follows from the first, as in most files
        return first
    return np.unique(first.astype(np.int64) * (int(second.max()) + 1) + second, return_inverse=True)[1].reshape(-1)
