"""Names of objects as parts of file names."""

from __future__ import annotations

import hashlib
import re

# What no system's file names can hold, the sign that stands before its code, and what is no character.
UNSAFE = re.compile(r'[\x00-\x1f\x7f<>:"/\\|?*%\ud800-\udfff]')
LONGEST = 120  # bytes


def file_name(name: str) -> str:
    """Encodes `name` as part of a file name: valid names stay as they are, different names stay different.

    Other characters become their code, `images%2Fv000_png`; long names are cut, and end in a hash of the whole.
    """
    text = UNSAFE.sub(lambda match: f"%{ord(match[0]):02X}", name)
    if len(text.encode()) <= LONGEST:
        return text
    digest = hashlib.sha256(name.encode("utf-8", "surrogatepass")).hexdigest()[:16]
    return f"{text.encode()[:LONGEST - 18].decode('utf-8', 'ignore')}-%{digest}"
