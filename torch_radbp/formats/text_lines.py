"""Lines, words and decimal numbers of large text files as numpy arrays, for the OBJ and PLY readers.

Files are read in blocks of whole lines, so that a million lines need no more memory than the numbers in them. Every word is
checked while it is converted; the first one that is no number is named with its line.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from typing import BinaryIO, NamedTuple

import numpy as np

BLOCK = 1 << 18  # whose arrays fit into a processor's cache: twice as fast as 4 MiB
LONGEST_LINE = 1 << 20
NEWLINE = b"\n"
BYTE_ORDER_MARK = b"\xef\xbb\xbf"
COMMENT = re.compile(rb"#(?!(?<=1\.#)(QNAN|SNAN|IND|INF))[^\n]*")  # but for 1.#QNAN, as Windows writes NaN
CONTINUATION = re.compile(rb"\\[ \t\r]*\n")
DECIMAL = re.compile(rb"[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?")
NOT_FINITE = re.compile(rb"[+-]?(nan(\(\w*\))?|inf(inity)?|1\.#(qnan|snan|ind|inf)\w*)", re.IGNORECASE)  # of C, of Windows
FAST_LENGTH = 18  # words up to this long have mantissas that int64 can hold
POWERS = 10.0 ** np.arange(FAST_LENGTH + 1)


class Lines(NamedTuple):
    """Lines of text, without blank ones, split into words."""

    text: np.ndarray  # (B,) uint8
    starts: np.ndarray  # (W,) offset in `text` at which each word begins
    ends: np.ndarray  # (W,) and ends
    first: np.ndarray  # (L + 1,) index of each line's first word, and of the word after the last line
    numbers: np.ndarray  # (L,) line numbers in the file, from 1

    @property
    def rows(self) -> int:
        """The number of lines."""
        return len(self.numbers)

    def between(self, start: int, stop: int) -> Lines:
        """The lines `start` to `stop` - 1."""
        return self._replace(first=self.first[start:stop + 1], numbers=self.numbers[start:stop])

    def word(self, index: int) -> str:
        """The text of one word, for messages."""
        text = self.text[self.starts[index]:self.ends[index]].tobytes().decode("utf-8", "backslashreplace")
        return repr(text if len(text) <= 40 else f"{text[:40]}...")

    def line_of_word(self, index: int) -> int:
        """The number of the line that contains a word."""
        return int(self.numbers[np.searchsorted(self.first, index, side="right") - 1])

    def values(self, words: np.ndarray, place: str, finite: bool = True) -> np.ndarray:
        """Converts words to numbers; `place` is the file, for messages.

        Args:
            words: (N,) indices into `starts`.
            finite: False also takes what stands for NaN and infinity, for the caller to look at.

        Returns:
            (N,) float64, correctly rounded.

        Raises:
            ValueError: names file and line of the first word that is not a finite decimal number.
        """
        values, valid = decimals(self.text, self.starts[words], self.ends[words])
        for index in () if finite else np.flatnonzero(~valid):
            word = self.text[self.starts[words[index]]:self.ends[words[index]]].tobytes()
            valid[index] = bool(NOT_FINITE.fullmatch(word) or DECIMAL.fullmatch(word))
            values[index] = np.nan
        if not valid.all():
            index = words[np.argmin(valid)]
            raise ValueError(f"{place}, line {self.line_of_word(index)}: expected a finite number, got {self.word(index)}")
        return values


def read_lines(file: BinaryIO, place: str, first_line: int = 1, comments: bool = False) -> Iterator[Lines]:
    """Yields the lines of the rest of a file, split into words, block by block.

    Args:
        file: what is left of it is read.
        place: its name, for messages.
        first_line: the number of the line that comes first.
        comments: `#` begins a comment, and a backslash at the end of a line continues it (OBJ).

    Raises:
        ValueError: if the file is not text, or has a line of more than a million characters.
    """
    while block := _whole_lines(file, place, first_line, comments):
        begin = len(BYTE_ORDER_MARK) if first_line == 1 and block.startswith(BYTE_ORDER_MARK) else 0
        yield split(block[begin:], place, first_line, comments)
        first_line += block.count(b"\n")


def _whole_lines(file: BinaryIO, place: str, first_line: int, comments: bool) -> bytes:
    """Reads about `BLOCK` bytes, up to the end of a line that is not continued; empty at the end of the file."""
    block = bytearray(file.read(BLOCK))
    rest = block
    while rest and (not rest.endswith(b"\n") or (comments and rest.rstrip(b" \t\r\n").endswith(b"\\"))):
        rest = file.readline(LONGEST_LINE)
        block += rest
        if len(rest) == LONGEST_LINE:
            raise ValueError(f"{place}, line {first_line + block.count(NEWLINE)}: the line is longer than {LONGEST_LINE} "
                             "characters; is this a text file?")
    return bytes(block)


def split(block: bytes, place: str, first_line: int, comments: bool) -> Lines:
    """Splits a block of whole lines into lines and words; see `read_lines`."""
    newlines = np.flatnonzero(np.frombuffer(block, np.uint8) == 10)
    if comments:
        block = COMMENT.sub(lambda match: b" " * len(match[0]), block)
        block = CONTINUATION.sub(lambda match: b" " * len(match[0]), block)
    text = np.frombuffer(block, np.uint8)
    _refuse_binary(text, place, first_line)
    edges = np.flatnonzero(np.diff(text > 32, prepend=False, append=False))
    starts, ends = edges[0::2], edges[1::2]
    breaks = np.flatnonzero(text[newlines] == 10)  # the line ends that are not continued
    line_starts = np.concatenate([[0], newlines[breaks] + 1])
    first = np.append(np.searchsorted(starts, line_starts), len(starts))
    filled = np.flatnonzero(np.diff(first))
    numbers = first_line + np.concatenate([[0], breaks + 1])[filled]
    return Lines(text, starts, ends, np.append(first[filled], len(starts)), numbers)


def _refuse_binary(text: np.ndarray, place: str, first_line: int) -> None:
    control = (text < 9) | ((text > 13) & (text < 32))
    if control.any():
        where = int(np.argmax(control))
        number = first_line + int(np.count_nonzero(text[:where] == 10))
        raise ValueError(f"{place}, line {number}: holds the byte 0x{text[where]:02x}, which no text file has; "
                         "is the file binary or UTF-16?")


def decimals(text: np.ndarray, starts: np.ndarray, ends: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Converts the words text[starts:ends] to decimal numbers.

    Words without an exponent are read by columns of characters: the mantissa as an integer below 2^53, divided by a power
    of ten below 10^22; both are exact in float64, so that the quotient is correctly rounded. All others are read one by one.

    Returns:
        (N,) float64, and (N,) bool whether each is a finite decimal number.

    Reference: Clinger 1990, "How to read floating point numbers accurately", for the exact case.
    """
    length = ends - starts
    negative, signed = text[starts] == ord("-"), np.isin(text[starts], (ord("-"), ord("+")))
    mantissa, places = np.zeros(len(starts), np.int64), np.zeros(len(starts), np.int8)
    digits, dotted = np.zeros(len(starts), np.int8), np.zeros(len(starts), bool)
    plain = length <= FAST_LENGTH
    for offset in range(int(length[plain].max(initial=0))):
        inside = plain & (offset < length)
        character = np.where(inside, text.take(starts + offset, mode="clip"), 0)
        digit = character - np.uint8(ord("0"))
        is_digit = digit < 10
        mantissa = np.where(is_digit, mantissa * 10 + digit, mantissa)
        places += is_digit & dotted
        digits += is_digit
        is_dot = (character == ord(".")) & ~dotted
        dotted |= is_dot
        plain &= is_digit | is_dot | ~inside | (signed if offset == 0 else False)
    plain &= (digits > 0) & (mantissa < 2**53)
    values = np.where(negative, -mantissa, mantissa) / POWERS[places]
    values[negative & (mantissa == 0)] = -0.0
    valid = plain
    for index in np.flatnonzero(~plain):
        word = text[starts[index]:ends[index]].tobytes()
        valid[index] = DECIMAL.fullmatch(word) is not None
        values[index] = float(word) if valid[index] else np.nan
    return values, valid & np.isfinite(values)
