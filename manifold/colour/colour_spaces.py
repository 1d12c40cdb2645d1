"""The colour spaces that picture files state: their tone curves, and their primaries as matrices to linear sRGB."""

from __future__ import annotations

import struct
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from manifold.colour.conversion import decode_srgb, xyz_to_srgb
from manifold.core.records import Array

Curve = Callable[[Array], Array]
"""A tone curve: from codes in [0, 1] to linear values."""

_WHITE_D65, _WHITE_D60, _WHITE_DCI = (0.3127, 0.3290), (0.32168, 0.33767), (0.314, 0.351)
_PRIMARIES = {
    "rec709": (0.640, 0.330, 0.300, 0.600, 0.150, 0.060, *_WHITE_D65),
    "p3d65": (0.680, 0.320, 0.265, 0.690, 0.150, 0.060, *_WHITE_D65),
    "p3dci": (0.680, 0.320, 0.265, 0.690, 0.150, 0.060, *_WHITE_DCI),
    "rec2020": (0.708, 0.292, 0.170, 0.797, 0.131, 0.046, *_WHITE_D65),
    "adobergb": (0.640, 0.330, 0.210, 0.710, 0.150, 0.060, *_WHITE_D65),
    "ap1": (0.713, 0.293, 0.165, 0.830, 0.128, 0.044, *_WHITE_D60),
    "ap0": (0.7347, 0.2653, 0.0, 1.0, 0.0001, -0.077, *_WHITE_D60),
}  # x and y of red, green, blue and white, by the names of the Color Interop Forum
_SHOWN = {
    "rec709": "sRGB", "p3d65": "Display P3", "p3dci": "DCI P3", "rec2020": "Rec. 2020", "adobergb": "Adobe RGB",
    "ap1": "ACEScg", "ap0": "ACES",
}  # fmt: skip
_CICP_PRIMARIES = {1: "rec709", 9: "rec2020", 11: "p3dci", 12: "p3d65"}  # ITU-T H.273
_ADOBE_GAMMA = 563 / 256  # of Adobe RGB (1998)
_PNG_SRGB = 45455  # gAMA of pictures in sRGB
_WHITE_PCS = (0.9642, 1.0, 0.8249)  # D50, the white of ICC profiles
# Rounding of chromaticities, numbers of profiles and sampled curves in files of one space. A gamma of 2.2 is 9e-3 from
# sRGB's curve, and the triangle of its primaries has an area of 0.11.
_SAME = 3e-3
_MOST_TAGS = 100  # of a profile; those of cameras and displays have some 20


@dataclass(frozen=True, eq=False)
class ColourSpace:
    """A colour space that a file states.

    Attributes:
        name: its name in notes and messages.
        curves: the tone curve, or those of red, green and blue; empty for linear values, None if the file does not
            say.
        to_srgb: the primaries in linear sRGB, one per row, shape (3, 3); None for those of sRGB.
    """

    name: str
    curves: tuple[Curve, ...] | None = None
    to_srgb: Array | None = None


SRGB = ColourSpace("sRGB", (decode_srgb,))


def power(gamma: float) -> tuple[Curve, ...]:
    """Return the tone curve `codes ** gamma` as a tuple of one function, empty if gamma is 1."""
    return () if abs(gamma - 1.0) < _SAME else (lambda codes: np.maximum(codes, 0.0) ** gamma,)


def _rec709_curve(codes: Array) -> Array:
    return np.where(codes < 0.081, codes / 4.5, ((np.maximum(codes, 0.0) + 0.099) / 1.099) ** (1.0 / 0.45))


def of_primaries(primaries: Sequence[float], curves: tuple[Curve, ...] | None) -> ColourSpace | None:
    """Return the colour space with the chromaticities x, y of red, green, blue and white; None if degenerate."""
    known = [key for key, xy in _PRIMARIES.items() if np.allclose(primaries, xy, atol=_SAME)]
    if known == ["rec709"]:
        return ColourSpace("sRGB", curves)
    x, y = np.asarray(_PRIMARIES[known[0]] if known else primaries, dtype=np.float64).reshape(4, 2).T
    xyz = np.column_stack([x, y, 1.0 - x - y])
    if not (np.isfinite(xyz).all() and abs(np.linalg.det(xyz[:3])) > _SAME and y[3] > 0.0):
        return None
    xyz[3] /= y[3]
    scale = np.linalg.solve(xyz[:3].T, xyz[3])
    name = _SHOWN[known[0]] if known else "RGB of its own primaries"
    return ColourSpace(name, curves, xyz_to_srgb(scale[:, None] * xyz[:3], xyz[3]))


def named(name: str) -> ColourSpace | None:
    """Return a space by its identifier of the Color Interop Forum, such as lin_ap1_scene; None for unknown ones."""
    curve, _, rest = name.lower().partition("_")
    curves = {
        "lin": (), "srgb": (decode_srgb,), "g18": power(1.8), "g22": power(2.2), "g24": power(2.4), "g26": power(2.6),
    }.get(curve)  # fmt: skip
    primaries = rest.partition("_")[0]
    if name.lower() in ("linear", "lin_srgb", "scene_linear"):
        return ColourSpace("linear sRGB", ())
    if curves is None or primaries not in _PRIMARIES:
        return None
    return of_primaries(_PRIMARIES[primaries], curves)


def adobe_rgb() -> ColourSpace | None:
    """Return Adobe RGB (1998)."""
    return of_primaries(_PRIMARIES["adobergb"], power(_ADOBE_GAMMA))


def of_png(chunks: dict[bytes, bytes]) -> ColourSpace | None:
    """Return the colour space that the chunks cICP, sRGB, gAMA and cHRM of a PNG file state; None if it is unsupported.

    Without these chunks, return sRGB primaries with an unknown tone curve.
    Source: PNG specification, third edition, section 4.3.
    """
    if len(cicp := chunks.get(b"cICP", b"")) == 4:
        primaries, transfer, matrix, is_full = cicp
        curves = {
            1: (_rec709_curve,), 4: power(2.2), 5: power(2.8), 6: (_rec709_curve,), 8: (), 13: (decode_srgb,),
            14: (_rec709_curve,), 15: (_rec709_curve,),
        }.get(transfer)  # fmt: skip
        key = _CICP_PRIMARIES.get(primaries)
        if curves is None or key is None or matrix != 0 or is_full != 1:
            return None
        return of_primaries(_PRIMARIES[key], curves)
    if b"sRGB" in chunks:
        return SRGB
    curves = None
    if len(gamma := chunks.get(b"gAMA", b"")) == 4 and (value := int.from_bytes(gamma, "big")) > 0:
        curves = (decode_srgb,) if abs(value - _PNG_SRGB) < 100 else power(1e5 / value)
    if len(stated := chunks.get(b"cHRM", b"")) == 32:
        white, *primaries_of = np.array(struct.unpack(">8I", stated)).reshape(4, 2) / 1e5
        return of_primaries(np.concatenate([*primaries_of, white]).tolist(), curves)
    return ColourSpace("sRGB", curves)


def of_profile(profile: bytes, name: str) -> ColourSpace | None:
    """Return the space of an ICC profile of primaries and tone curves, or of one curve for grey; None for others.

    It is read here because Pillow's ImageCms converts colours of 8 bits only. Source: ICC.1:2022, sections 8.3.3, 10.6
    and 10.18.
    """
    try:
        tags = _tags(profile)
        curves: tuple[Curve, ...]
        to_srgb: Array | None
        if profile[16:20] == b"GRAY":
            curves, to_srgb = (_curve(tags[b"kTRC"]),), None
        elif profile[16:20] == b"RGB " and profile[20:24] == b"XYZ ":
            curves = tuple(_curve(tags[key]) for key in (b"rTRC", b"gTRC", b"bTRC"))
            xyz = [struct.unpack(">3i", tags[key][8:20]) for key in (b"rXYZ", b"gXYZ", b"bXYZ")]
            to_srgb = xyz_to_srgb(np.array(xyz) / 65536.0, np.array(_WHITE_PCS))
        else:
            return None
    except (KeyError, ValueError, IndexError, struct.error):
        return None
    codes = np.linspace(0.0, 1.0, 256)
    with np.errstate(all="ignore"):  # of curves in damaged profiles
        linear = np.array([curve(codes) for curve in curves])
    if not np.isfinite(linear).all():
        return None
    if np.abs(linear - codes).max() < _SAME:
        curves = ()
    elif np.abs(linear - decode_srgb(codes)).max() < _SAME:
        curves = (decode_srgb,)
    if to_srgb is not None and np.abs(to_srgb - np.eye(3)).max() < _SAME:
        to_srgb = None
    is_srgb = to_srgb is None and curves == (decode_srgb,)
    return SRGB if is_srgb else ColourSpace(name, curves, to_srgb)


def _tags(profile: bytes) -> dict[bytes, bytes]:
    """Return the tags of an ICC profile, by signature."""
    (count,) = struct.unpack(">I", profile[128:132])
    if profile[36:40] != b"acsp" or count > _MOST_TAGS:
        raise ValueError("not a profile")
    table = [struct.unpack(">4sII", profile[132 + 12 * k : 144 + 12 * k]) for k in range(count)]
    return {signature: profile[start : start + size] for signature, start, size in table}


def _curve(tag: bytes) -> Curve:
    """Return the tone curve of a tag of an ICC profile."""
    kind = tag[:4]
    if kind == b"curv":
        (count,) = struct.unpack(">I", tag[8:12])
        if count == 0:
            return lambda codes: codes
        table = np.array(struct.unpack(f">{count}H", tag[12 : 12 + 2 * count]), dtype=np.float64)
        if count == 1:
            exponent = float(table[0]) / 256.0
            return lambda codes: np.maximum(codes, 0.0) ** exponent
        at = np.linspace(0.0, 1.0, count)
        return lambda codes: np.interp(codes, at, table / 65535.0)
    if kind != b"para":
        raise ValueError("not a curve")
    (form,) = struct.unpack(">H", tag[8:10])
    n = (1, 3, 4, 5, 7)[form]
    given = np.array(struct.unpack(f">{n}i", tag[12 : 12 + 4 * n])) / 65536.0
    g, a, b, c, d, e, f = np.pad(given, (0, 7 - n)).tolist()
    if form == 0:
        a, d = 1.0, -1.0
    elif form in (1, 2):  # zero, or c, below -b / a
        c, d, e, f = 0.0, -b / a if a else np.inf, c, c
    return lambda codes: np.where(codes >= d, np.maximum(a * codes + b, 0.0) ** g + e, c * codes + f)
