"""Changed bytes, texts, documents and archives."""

from __future__ import annotations

import io
import random
import re
import zipfile
from collections.abc import Sequence

TOKENS = (
    "null", "[]", "{}", "-1", "0", "1e999", "NaN", "9" * 5000, '""', '"../evil"', "true", "[[[[", "}", "$x", "\\ud800",
    "é", '"type"', '"/dev/zero"', '"/dev/stdin"', "\x00", "\x1b[31m",
)  # fmt: skip
XML_TOKENS = (
    *TOKENS, "<include filename='s.xml'/>", "<default name='a' value='$a$a'/>", "<path value='.'/>", "</scene>",
    "<bsdf type='../x'/>", "<scene>", "type=''", "<string name='filename' value='/dev/zero'/>", "<!-- -->", "<![CDATA[",
    "&amp;", "&x;",
)  # fmt: skip
WORDS = (
    *(token.encode("utf-8", "surrogatepass") for token in TOKENS),
    b"-",
    b",",
    b"\n",
    b"\xff\xfe",
    bytes(9),
)
NUMBER = re.compile(rb"[-+]?\d+(\.\d+)?")
FLOATS = tuple(
    bytes.fromhex(f) for f in ("0000c07f", "0000807f", "000080ff", "000080bf", "01000000", "9ec97f7f")
)
"""NaN, infinities, -1, the least and nearly the largest number of single precision."""
INTEGERS = (0, 1, 0x7F, 0x80, 0xFF, 0xFFFF, 0x7FFFFFFF, 0xFFFFFFFF, 1 << 40, (1 << 63) - 1, (1 << 64) - 1)


VALUES = (
    None,
    [],
    {},
    "",
    "../evil",
    -1,
    0,
    1e308,
    10**400,
    True,
    [[]],
    {"type": []},
    "x" * 10_000,
    "/dev/zero",
)


def of_bytes(content: bytes, rng: random.Random, places: Sequence[int] = ()) -> bytes:
    """Some bits, bytes, numbers, words, lengths or ends changed; where structure lies more often.

    Args:
        content: what is changed.
        rng: of the change.
        places: where structure lies; by default nearer to the start.
    """
    data = bytearray(content)
    for _ in range(rng.choice((1, 1, 1, 2, 8))):
        place = int(len(data) * rng.random() ** rng.choice((1, 4))) if data else 0
        if places and rng.random() < 0.7:
            place = rng.choice(places)
        kind = rng.randrange(10)
        if kind == 0 and place < len(data):
            data[place] ^= 1 << rng.randrange(8)
        elif kind == 1:
            data[place : place + rng.choice((1, 4, 64))] = rng.randbytes(rng.choice((1, 4, 64)))
        elif kind == 2:
            width = rng.choice((1, 2, 4, 8))
            data[place : place + width] = (rng.choice(INTEGERS) % (1 << 8 * width)).to_bytes(width, "little")
        elif kind == 3:
            del data[place:]
        elif kind == 4:
            del data[place : place + rng.choice((1, 8, 512))]
        elif kind == 5:
            data[place:place] = data[rng.randrange(len(data) + 1) :][: rng.choice((8, 512))]
        elif kind == 6:
            data += bytes(rng.choice((1, 4096)))
        elif kind == 7:
            data[place:place] = rng.choice(WORDS)
        elif kind == 8:
            at = place // 4 * 4
            data[at : at + 4] = rng.choice(FLOATS)
        elif found := NUMBER.search(data, place, place + 200):
            data[found.start() : found.end()] = rng.choice(WORDS)
    return bytes(data)


def of_archive(content: bytes, rng: random.Random) -> bytes:
    """A workbook, of which one part is changed, mostly a sheet; packed anew."""
    out = io.BytesIO()
    with (
        zipfile.ZipFile(io.BytesIO(content)) as archive,
        zipfile.ZipFile(out, "w", zipfile.ZIP_DEFLATED) as made,
    ):
        names = archive.namelist()
        chosen = rng.choice([*names, *[name for name in names if "/worksheets/" in name] * 5])
        for name in names:
            part = archive.read(name)
            made.writestr(name, of_bytes(part, rng) if name == chosen else part)
    return out.getvalue()


def of_text(text: str, rng: random.Random, tokens: tuple[str, ...] = TOKENS) -> str:
    """Words exchanged for others, parts doubled, left out or put elsewhere."""
    for _ in range(rng.choice((1, 1, 2, 5))):
        a, b = sorted(rng.randrange(len(text) + 1) for _ in range(2))
        b = min(b, a + rng.choice((0, 1, 5, 40, 400)))
        kind = rng.randrange(4)
        if kind == 0:
            text = text[:a] + rng.choice(tokens) + text[b:]
        elif kind == 1:
            text = text[:a] + text[b:]
        elif kind == 2:
            text = text[:a] + text[a:b] * rng.choice((2, 3, 50)) + text[b:]
        else:
            place = rng.randrange(len(text) + 1)
            text = text[:place] + text[a:b] + text[place:]
    return text


def of_json(content: object, rng: random.Random) -> object:
    """One value of a document exchanged for another, of any type."""
    parents, waiting = [], [content]
    while waiting:
        node = waiting.pop()
        keys = list(node) if isinstance(node, dict) else range(len(node)) if isinstance(node, list) else ()
        parents += [(node, key) for key in keys]
        waiting += [node[key] for key in keys]
    if parents:
        node, key = rng.choice(parents)
        node[key] = rng.choice(VALUES)
    return content
