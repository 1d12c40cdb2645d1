"""Names of unsupported formats for error messages, guessed from the beginning of a file."""

from __future__ import annotations

import codecs
import re
from collections.abc import Iterable

MUELLER = "Mueller matrices of a polarised BRDF (KAIST .pbsdf)"
"""Name of tensor files with the fields `MUELLER_FIELDS`. Source: Baek et al. 2020."""
MUELLER_FIELDS = ("M", "phi_d", "theta_d", "theta_h", "wvls")

# By how files begin.
_FOREIGN = (
    (b"tensor_file\0", "an RGL file"),
    (b"\x89HDF\r\n\x1a\n", "an HDF5 file (NetCDF, AxF, MATLAB, or another)"),
    (b"CDF\x01", "a NetCDF file"),
    (b"CDF\x02", "a NetCDF file"),
    (b"PK\x03\x04", "a ZIP archive"),
    (b"\x1f\x8b", "a gzip archive"),
    (b"\xd0\xcf\x11\xe0", "an old Office file such as .xls"),
    (b"7z\xbc\xaf\x27\x1c", "a 7z archive (Substance .sbsar, or another)"),
    (b"glTF", "a binary glTF file"),
    (b"%PDF", "a PDF document"),
    (b"\x89PNG", "a PNG picture"),
    (b"\xff\xd8\xff", "a JPEG picture"),
    (b"\x76\x2f\x31\x01", "an OpenEXR picture"),
    (b"II*\0", "a TIFF picture"),
    (b"MM\0*", "a TIFF picture"),
    (b"SCATFUN", "a Fourier BSDF of layerlab or pbrt-v3"),
    (b"NVIDIA ARC MBSDF", "a measured BSDF of MDL (.mbsdf) of an unknown version"),
    (b"MATLAB 5.0", "a MATLAB file"),
    (b"\x93NUMPY", "a NumPy array"),
    (b"OPTIS - ", "a surface file of Ansys Speos"),
    (b"TracePro", "a surface property file of TracePro"),
    (b"#?RADIANCE", "a picture or BSDF interpolant of Radiance"),
    (b"PEPE2D", "a binary spectrum of PerkinElmer (.sp)"),
    (b"##TITLE", "a JCAMP-DX spectrum"),
    (b"H|", "a message of a clinical analyser (ASTM E1394)"),
    (b"version https://git-lfs", "a Git LFS pointer, not the file itself"),
)
# By tags, and by keys at the beginning of a line, in lower case: words of prose say nothing.
_ZEMAX = r"^\W*(spectralcontent|scattertype|sampleorientation|samplerotation)\b"
_FOREIGN_PATTERNS = (
    (r"\A\W*<(!doctype )?html\b", "an HTML page, probably from a failed download"),
    (r"<(\w+:)?(windowelement|opticsdefinition)\b", "a Radiance / WINDOW BSDF (XML)"),
    (r"\A\W*<iestm27", "a spectrum of a light or a reflectance (.spdx)"),
    (r"\A\W*<\?xml\b", "an XML document"),
    (r"^#(alta|param_in|dim) ", "a data or function file of ALTA"),
    (r"^param0_list\b", "a BSDF of BSDFProcessor (SSDD)"),
    (r"^typecolormodel\b", "a BRDF or BTDF of Integra (.ddr, .ddt)"),
    (r"^spheremesh:", "a spherical mesh of LightTools"),
    (r"^::begin shader\b", "an analytic BRDF of Disney's BRDF Explorer"),
    (r"^(theta lighting|phi measure step)\b", "a REFLET measurement (Light Tec)"),
    (r"^\s*bsdfdata\b", "a scatter model of ASAP"),
    (r"^table_bsdf_data\b", "a surface property file of TracePro"),
    # Mini-Diff files share most keys with Zemax files; only theirs write the incidence as AOI.
    (rf"^\s*aoi\b(?!\s*[,;])|mini[ -]?diff(?s:.*){_ZEMAX}", "a Synopsys Mini-Diff BSDF"),
    (_ZEMAX, "a Zemax BSDF"),
)


_JSON = re.compile(r"\s*(\{\s*[\"}]|\[\s*[\[{\"\d-])")


def resembles_json(text: str) -> bool:
    """Return whether a text begins as JSON does.

    >>> resembles_json('[{"theta": 0'), resembles_json("[Header]")
    (True, False)
    """
    return _JSON.match(text) is not None


_IN_ARCHIVES = (
    (r"\.u3m$", "a U3M material"),
    (r"^word/", "a Word document"),
    (r"^ppt/", "a PowerPoint presentation"),
    (r"^content\.xml$", "an OpenDocument file"),
    (r"\.usd[ac]?$", "a USDZ file"),
    (r"\.mtlx$", "a MaterialX archive"),
)  # fmt: skip


def name_archive(names: Iterable[str]) -> str:
    """Guess the kind of a ZIP archive from the names of its parts.

    >>> name_archive(["fabric.u3m", "textures/base.png"])
    'a U3M material'
    """
    names = list(names)
    found = (words for pattern, words in _IN_ARCHIVES if any(re.search(pattern, name) for name in names))
    return next(found, "a ZIP archive")


def name_format(head: bytes) -> str:
    """Guess the format of a file from its first kilobytes."""
    if head.startswith(b"tensor_file\0") and all(name.encode() in head[:1024] for name in MUELLER_FIELDS):
        return MUELLER
    for magic, name in _FOREIGN:
        if head.startswith(magic):
            return name
    # Without zeros UTF-16 reads like ASCII.
    text = head.replace(b"\0", b"").decode("latin-1").lower().replace("\r", "\n")
    for pattern, name in _FOREIGN_PATTERNS:
        if re.search(pattern, text, re.MULTILINE):
            return name
    if resembles_json(text):
        return "a JSON document"
    if not any(byte < 32 and byte not in b"\t\n\r\f" for byte in head) and _is_utf8(head):
        return "a text file"
    return "an unknown format"


def _is_utf8(head: bytes) -> bool:
    """Return whether the beginning of a file is UTF-8, possibly cut off within a character."""
    try:
        codecs.getincrementaldecoder("utf-8")().decode(head)
    except UnicodeDecodeError:
        return False
    return True
