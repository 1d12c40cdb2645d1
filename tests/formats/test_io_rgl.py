"""RGL files: what is read is what was written, and no damage gets further than one error."""

from __future__ import annotations

import dataclasses
import mmap
import os
import random
import re
import struct
import tracemalloc
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from attack.mutations import of_bytes
from helpers.paths import real_rgl_files
from helpers.sample_files import assert_same, assert_same_array, sample_file
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from manifold.core.errors import FileAccessError, FileFormatError, ManifoldError, MissingFileError, UsageError
from manifold.core.records import Array, BsdfFile
from manifold.formats.tensor_file import read_tensors, write_tensors
from manifold.io_rgl import material_name, read_bsdf, write_bsdf

REAL_FILES = real_rgl_files()
NO_REAL_FILES = "no real RGL files at hand; name their folder in MANIFOLD_RGL_DIR"
needs_real_files = pytest.mark.skipif(not REAL_FILES, reason=NO_REAL_FILES)

DTYPES = ("u1", "i1", "u2", "i2", "u4", "i4", "u8", "i8", "f2", "f4", "f8")
DTYPE_CODES = {dtype: code for code, dtype in enumerate(DTYPES, start=1)}
PREAMBLE_SIZE = 18
PIPELINE_ORDER = [
    "version", "description", "phi_i", "theta_i", "wavelengths", "sigma", "ndf", "vndf", "luminance", "spectra",
    "jacobian", "valid",
]  # fmt: skip


# A second writer, slow and obvious, that writes whatever it is told: the damaged files of these tests.


@dataclasses.dataclass
class Field:
    """One field as a file announces it, and the bytes it stores, which need not agree."""

    name: bytes
    code: int
    shape: tuple[int, ...]
    data: bytes
    offset: int | None = None  # None: behind the previous field
    ndim: int | None = None  # None: the length of the shape
    name_length: int | None = None  # None: the length of the name

    @classmethod
    def of(cls, name: str, array: Array) -> Field:
        return cls(name.encode(), DTYPE_CODES[array.dtype.str[1:]], array.shape, array.tobytes())

    def header(self, offset: int) -> bytes:
        length = len(self.name) if self.name_length is None else self.name_length
        ndim = len(self.shape) if self.ndim is None else self.ndim
        return (
            struct.pack("<H", length)
            + self.name
            + struct.pack("<HBQ", ndim, self.code, offset)
            + b"".join(struct.pack("<Q", size) for size in self.shape)
        )


def tensor_file(
    fields: list[Field],
    *,
    magic: bytes = b"tensor_file\0",
    version: tuple[int, int] = (1, 0),
    count: int | None = None,
    shift: int = 0,
) -> bytes:
    """A tensor file; `shift` moves every field off its alignment."""
    position = PREAMBLE_SIZE + sum(len(field.header(0)) for field in fields)
    header = magic + bytes(version) + struct.pack("<I", len(fields) if count is None else count)
    data = b""
    for field in fields:
        padding = -(position + len(data)) % 8 + shift
        data += bytes(padding)
        header += field.header(position + len(data) if field.offset is None else field.offset)
        data += field.data
    return header + data


def small_fields(spectral: bool = True) -> dict[str, Array]:
    """The fields of a valid file of about 1.5 kB."""
    file = small_file(spectral)
    fields = {
        "version": np.array(file.version, "<u4"),
        "description": np.frombuffer(file.description.encode(), "u1"),
        "phi_i": file.phi_i_rad,
        "theta_i": file.theta_i_rad,
        "wavelengths": file.wavelengths_nm,
        "sigma": file.sigma,
        "ndf": file.ndf,
        "vndf": file.vndf,
        "luminance": file.luminance,
        "spectra" if spectral else "rgb": file.spectra,
        "jacobian": np.array([1], "u1"),
        "valid": file.valid,
    }
    return {name: np.array(array) for name, array in fields.items() if array is not None}


def small_file(spectral: bool = True, azimuths: int = 1) -> BsdfFile:
    wavelengths_nm = np.array([400, 500], np.float32) if spectral else None
    return sample_file("small", wavelengths_nm=wavelengths_nm, azimuths=azimuths, size=2)


def raw(fields: dict[str, Array]) -> list[Field]:
    return [Field.of(name, array) for name, array in fields.items()]


def error_of(path: Path, content: bytes | None = None, read: Callable[[Path], object] = read_bsdf) -> str:
    """The one line that reading `path` (with this content) raises."""
    if content is not None:
        path.write_bytes(content)
    with pytest.raises(FileFormatError) as caught:
        read(path)
    text = str(caught.value)
    assert "\n" not in text
    assert len(text) < 600
    assert text.startswith(f"{path.name}: ")
    assert "; " in text  # behind it stands what to do
    return text


# --- What is read is what was written ---


def test_zeros_among_the_measured_cells_do_not_turn_the_mask_over(rng: np.random.Generator) -> None:
    file, mask = masked_file(rng)
    lost = rng.random(mask.shape) < 0.75
    black = dataclasses.replace(file, spectra=np.where(lost[:, :, None], np.float32(0), file.spectra))
    for bits in (mask, ~mask):
        found = dataclasses.replace(black, valid=np.packbits(bits)).measured_mask
        np.testing.assert_array_equal(found, mask)


@needs_real_files
@pytest.mark.parametrize("path", REAL_FILES, ids=lambda path: path.stem)
def test_real_files_round_trip_byte_for_byte(path: Path, tmp_path: Path) -> None:
    original = read_bsdf(path)
    copy = tmp_path / path.name
    write_bsdf(copy, original)
    assert_same(read_bsdf(copy), original)
    before, after = read_tensors(path), read_tensors(copy)
    assert list(after) == list(before)
    for name in before:
        assert_same_array(after[name], before[name], name)


@st.composite
def records(draw: st.DrawFn) -> BsdfFile:
    """Any record that a file may hold: all kinds, odd shapes, odd values, unknown fields."""
    rng = np.random.default_rng(draw(st.integers(0, 2**32)))
    P, T = draw(st.integers(1, 4)), draw(st.integers(2, 4))
    B = draw(st.integers(1, 4) | st.none())
    H = draw(st.integers(2, 4))
    odd = np.array([0.0, -0.0, 1e-45, 3.4e38, 1.0], np.float32)

    def values(*shape: int) -> Array:
        array = rng.random(shape, dtype=np.float32)
        return np.where(rng.random(shape) < 0.2, rng.choice(odd, shape), array)

    def grid(low: float, high: float, n: int) -> Array:
        return np.linspace(low, high, n + 2, dtype=np.float32)[1:-1]

    side = st.integers(2, 5)
    vndf = values(P, T, draw(side), draw(side))
    vndf[..., 0, 0] = 1  # a slice without any density would be refused
    cells = P * T * H * H
    code = st.sampled_from(sorted(DTYPE_CODES))
    shape = st.lists(st.integers(0, 3), max_size=4).map(tuple)
    name = st.text(max_size=12).filter(
        lambda text: text.isprintable() and text not in [*PIPELINE_ORDER, "rgb"]
    )
    extra = {
        key: rng.integers(0, 100, size).astype("<" + dtype)
        for key, (dtype, size) in draw(st.dictionaries(name, st.tuples(code, shape), max_size=3)).items()
    }
    version_part = st.integers(0, 2**32 - 1)
    return BsdfFile(
        name="any",
        description=draw(st.text(st.characters(exclude_categories=["Cs"]), max_size=30)),
        version=(draw(version_part), draw(version_part)),
        phi_i_rad=grid(-np.pi, np.pi, P),
        theta_i_rad=grid(0, np.pi / 2, T),
        wavelengths_nm=None if B is None else grid(300, 1000, B),
        sigma=rng.random((draw(side), draw(side)), dtype=np.float32) + np.float32(1e-30),
        ndf=values(draw(side), draw(side)),
        vndf=vndf,
        luminance=values(P, T, H, H),
        spectra=values(P, T, 3 if B is None else B, H, H)
        * draw(st.sampled_from([np.float32(1), np.float32(-1)])),
        jacobian=draw(st.booleans()),
        valid=rng.integers(0, 256, draw(st.sampled_from([cells, -(-cells // 8)])), dtype=np.uint8),
        extra=extra,
    )


@settings(max_examples=50, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(file=records())
def test_any_record_round_trips_byte_for_byte(file: BsdfFile, tmp_path: Path) -> None:
    path = tmp_path / ("any_rgb.bsdf" if file.wavelengths_nm is None else "any_spec.bsdf")
    write_bsdf(path, file)
    found = read_bsdf(path)
    assert_same(found, file)
    again = tmp_path / "again.bsdf"
    write_bsdf(again, found)
    assert again.read_bytes() == path.read_bytes()


@pytest.mark.parametrize("shift", [0, 1])  # 1: no field is aligned, all must be copied
def test_a_hand_made_file_is_read_as_it_was_made(tmp_path: Path, shift: int) -> None:
    fields = small_fields() | {f"extra {dtype}": np.arange(3).astype("<" + dtype) for dtype in DTYPE_CODES}
    path = tmp_path / "made_spec.bsdf"
    path.write_bytes(tensor_file(raw(fields), shift=shift))
    found = read_tensors(path)
    assert list(found) == list(fields)
    for name, array in fields.items():
        assert_same_array(found[name], array, name)
        assert found[name].flags.aligned
    file = read_bsdf(path)
    assert_same_array(file.spectra, fields["spectra"], "spectra")
    assert list(file.extra) == list(found)[len(PIPELINE_ORDER) :]


def test_fields_are_written_in_the_order_of_real_files_and_aligned(tmp_path: Path) -> None:
    path = tmp_path / "x_spec.bsdf"
    write_bsdf(path, small_file())
    content = path.read_bytes()
    assert list(read_tensors(path)) == [*PIPELINE_ORDER, "note", "path/../odd"]
    position = PREAMBLE_SIZE
    for _ in range(14):
        (length,) = struct.unpack_from("<H", content, position)
        ndim, _, offset = struct.unpack_from("<HBQ", content, position + 2 + length)
        assert offset % 8 == 0
        position += 2 + length + 11 + 8 * ndim


def test_a_description_that_is_not_utf8_survives(tmp_path: Path) -> None:
    fields = small_fields() | {"description": np.frombuffer(b"caf\xe9 \xff\0", "u1")}
    (tmp_path / "a.bsdf").write_bytes(tensor_file(raw(fields)))
    write_bsdf(tmp_path / "b.bsdf", read_bsdf(tmp_path / "a.bsdf"))
    assert read_tensors(tmp_path / "b.bsdf")["description"].tobytes() == b"caf\xe9 \xff\0"


@pytest.mark.parametrize(
    ("file_name", "material"),
    [
        ("a_spec.bsdf", "a"),
        ("a_rgb.bsdf", "a"),
        ("a.bsdf", "a"),
        ("cm_spec_x_rgb.bsdf", "cm_spec_x"),
        ("a", "a"),
    ],
)
def test_the_material_is_named_after_the_file(file_name: str, material: str) -> None:
    assert material_name(Path("folder.bsdf") / file_name) == material


@pytest.mark.parametrize("kind", ["bits", "bytes", "bytes with axes"])
def test_the_mask_may_have_a_bit_or_a_byte_per_cell(tmp_path: Path, kind: str) -> None:
    mask = np.ones((1, 3, 2, 2), np.uint8)
    valid = {"bits": np.packbits(mask), "bytes": mask.reshape(-1), "bytes with axes": mask}[kind]
    write_bsdf(tmp_path / "x.bsdf", dataclasses.replace(small_file(), valid=valid))
    assert_same_array(read_bsdf(tmp_path / "x.bsdf").valid, valid, "valid")


# --- The mask ---


def masked_file(rng: np.random.Generator) -> tuple[BsdfFile, Array]:
    """A file like the real ones, and its mask: zeros near grazing, 3 % of the rest extrapolated."""
    file = sample_file("masked", size=16)
    zero = np.broadcast_to(np.arange(16) >= 14, file.luminance.shape)
    spectra = np.where(zero[:, :, None], np.float32(0), np.float32(1)) + np.zeros_like(file.spectra)
    return dataclasses.replace(file, spectra=spectra), ~zero & (rng.random(zero.shape) >= 0.03)


@pytest.mark.parametrize("pack", [np.packbits, lambda mask: mask.reshape(-1).astype(np.uint8)])
def test_either_meaning_of_the_bits_gives_the_same_mask(
    pack: Callable[[Array], Array], rng: np.random.Generator
) -> None:
    file, mask = masked_file(rng)
    for bits in (mask, ~mask):  # set means measured up to pipeline version 3.1, unmeasured from 3.2 on
        found = dataclasses.replace(file, valid=pack(bits)).measured_mask
        assert found.dtype == np.bool_
        np.testing.assert_array_equal(found, mask)


@needs_real_files
@pytest.mark.parametrize("path", REAL_FILES, ids=lambda path: path.stem)
def test_the_mask_of_a_real_file_follows_its_zeros(path: Path) -> None:
    file = read_bsdf(path)
    mask, non_zero = file.measured_mask, np.any(file.spectra != 0, axis=2)
    assert mask.shape == file.luminance.shape
    # 3 to 4 % of the non-zero cells were extrapolated by the database (2 % on the finer grid).
    assert np.mean(mask[non_zero]) > 0.96
    # Not none: up to 46 of 8192 cells are marked measured and hold zeros in all channels (0.6 %).
    assert np.mean(mask & ~non_zero) < 0.006


# --- Reading maps the file ---


def test_reading_maps_the_file_and_copies_nothing(tmp_path: Path) -> None:
    path = tmp_path / "large_spec.bsdf"
    write_bsdf(path, sample_file("large", size=96))  # 7.7 MB
    read_bsdf(path)  # whatever is imported or cached at the first call
    tracemalloc.start()
    file = read_bsdf(path)
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert file.spectra.nbytes > 7e6
    assert peak < 0.2e6


def root_of(array: Array) -> object:
    """What owns the memory of an array."""
    owner: object = array
    while isinstance(owner, np.ndarray):
        owner = owner.base
    return owner.obj if isinstance(owner, memoryview) else owner


def test_aligned_fields_are_views_of_one_map(tmp_path: Path) -> None:
    path = tmp_path / "x_spec.bsdf"
    write_bsdf(path, small_file())
    owners = [root_of(array) for array in read_tensors(path).values()]
    assert isinstance(owners[0], mmap.mmap)
    assert all(owner is owners[0] for owner in owners)


def test_a_record_outlives_the_replacement_of_its_file(tmp_path: Path) -> None:
    path = tmp_path / "x_spec.bsdf"
    write_bsdf(path, small_file())
    mapped = read_bsdf(path)
    write_bsdf(path, small_file(azimuths=4))
    assert_same_array(mapped.spectra, small_file().spectra, "spectra")
    path.unlink()
    assert_same_array(mapped.spectra, small_file().spectra, "spectra")


@pytest.mark.parametrize("shift", [0, 1])
def test_arrays_of_a_file_are_read_only(tmp_path: Path, shift: int) -> None:
    (tmp_path / "x.bsdf").write_bytes(tensor_file(raw(small_fields()), shift=shift))
    file = read_bsdf(tmp_path / "x.bsdf")
    for array in (file.spectra, file.valid, file.phi_i_rad):
        with pytest.raises(ValueError, match="read-only"):
            array[...] = 0
    with pytest.raises(TypeError):
        file.extra["new"] = file.valid  # type: ignore[index]


def test_a_file_can_be_written_over_itself(tmp_path: Path) -> None:
    path = tmp_path / "x_spec.bsdf"
    write_bsdf(path, small_file())
    before = path.read_bytes()
    mapped = read_bsdf(path)
    write_bsdf(path, mapped)
    assert path.read_bytes() == before
    assert_same_array(mapped.spectra, small_file().spectra, "spectra")


# --- Damage names its field ---

NAN, INF = np.float32("nan"), np.float32("inf")


def put(array: Array, index: Any, value: Any) -> Array:
    array = array.copy()
    array[index] = value
    return array


# What is wrong, in which field, and what the error says about it.
BAD_CONTENT: dict[str, tuple[str, Callable[[Array], Array], str]] = {
    "version of another dtype": ("version", lambda a: a.astype("<i8"), "int64.*uint32"),
    "version of three parts": ("version", lambda a: np.resize(a, 3), r"\(3,\)"),
    "description of another dtype": ("description", lambda a: a.astype("<u2"), "uint16.*uint8"),
    "two-dimensional phi_i": ("phi_i", lambda a: a[None], "1 axes"),
    "NaN in phi_i": ("phi_i", lambda a: a * NAN, "finite"),
    "phi_i beyond a turn": ("phi_i", lambda a: a + 7, "runs from 7 to 7"),
    "empty phi_i": ("phi_i", lambda a: a[:0], "at least 1"),
    "double precision in theta_i": ("theta_i", lambda a: a.astype("<f8"), "float64.*float32"),
    "theta_i in degrees": ("theta_i", np.rad2deg, "90.*radians"),
    "falling theta_i": ("theta_i", lambda a: a[::-1], "increasing"),
    "theta_i twice": ("theta_i", lambda a: put(a, 1, a[0]), "increasing"),
    "infinity in theta_i": ("theta_i", lambda a: put(a, 2, INF), "finite"),
    "one theta_i": ("theta_i", lambda a: a[:1], "at least 2"),
    "negative wavelengths": ("wavelengths", lambda a: -a[::-1], "positive"),
    "falling wavelengths": ("wavelengths", lambda a: a[::-1], "increasing"),
    "NaN in wavelengths": ("wavelengths", lambda a: put(a, 1, NAN), "finite"),
    "one-dimensional sigma": ("sigma", lambda a: a[0], "2 axes"),
    "sigma of one row": ("sigma", lambda a: a[:1], "at least 2"),
    "zero in sigma": ("sigma", lambda a: put(a, (1, 1), 0), "positive"),
    "NaN in sigma": ("sigma", lambda a: put(a, (0, 1), NAN), "finite"),
    "integers in ndf": ("ndf", lambda a: a.astype("<i4"), "int32.*float32"),
    "ndf of one column": ("ndf", lambda a: a[:, :1], "at least 2"),
    "negative ndf": ("ndf", lambda a: put(a, (0, 1), -1), "negative"),
    "infinity in ndf": ("ndf", lambda a: put(a, (0, 0), INF), "finite"),
    "vndf of another number of theta_i": ("vndf", lambda a: a[:, :2], r"3 along axis 1 \(theta_i\)"),
    "vndf of another number of phi_i": (
        "vndf",
        lambda a: np.concatenate([a, a]),
        r"1 along axis 0 \(phi_i\)",
    ),
    "three-dimensional vndf": ("vndf", lambda a: a[0], "4 axes"),
    "vndf of one row": ("vndf", lambda a: a[:, :, :1], "at least 2"),
    "negative vndf": ("vndf", lambda a: put(a, (0, 2, 0, 0), -1e-3), "negative"),
    "NaN in vndf": ("vndf", lambda a: put(a, (0, 2, 1, 1), NAN), "finite"),
    "a slice of vndf without density": ("vndf", lambda a: put(a, (0, 1), 0), r"\(0, 1\).* not zero"),
    "luminance that is not square": ("luminance", lambda a: np.concatenate([a, a], 3), "2 along axis 3"),
    "minus infinity in luminance": ("luminance", lambda a: put(a, (0, 0, 0, 0), -INF), "finite"),
    "spectra of four axes": ("spectra", lambda a: a[0], "5 axes"),
    "spectra of another number of bands": (
        "spectra",
        lambda a: a[:, :, :1],
        r"2 along axis 2 \(wavelengths\)",
    ),
    "spectra of another grid": ("spectra", lambda a: np.concatenate([a, a], 4), "2 along axis 4"),
    "half precision in spectra": ("spectra", lambda a: a.astype("<f2"), "float16.*float32"),
    "NaN in spectra": ("spectra", lambda a: put(a, (0, 2, 1, 1, 1), NAN), "finite"),
    "infinity in spectra": ("spectra", lambda a: put(a, (0, 0, 0, 0, 0), INF), "finite"),
    "jacobian of 2": ("jacobian", lambda a: a * 2, "is 2, expected 0 or 1"),
    "jacobian of two": ("jacobian", lambda a: np.resize(a, 2), r"\(2,\)"),
    "jacobian of another dtype": ("jacobian", lambda a: a.astype("<f4"), "float32.*uint8"),
    "mask of another size": ("valid", lambda a: np.resize(a, 5), "5 bytes"),
    "mask of another dtype": ("valid", lambda a: a.astype("<i1"), "int8.*uint8"),
}


@pytest.mark.parametrize("case", BAD_CONTENT)
def test_bad_content_names_its_field_when_read(case: str, tmp_path: Path) -> None:
    name, spoil, words = BAD_CONTENT[case]
    fields = small_fields()
    fields[name] = np.ascontiguousarray(spoil(fields[name]))
    text = error_of(tmp_path / "bad_spec.bsdf", tensor_file(raw(fields)))
    assert text.startswith(f"bad_spec.bsdf: field '{name}' ")
    assert re.search(words, text)


@pytest.mark.parametrize(
    "case",
    # A record holds its version, description and jacobian as plain values: they have no other dtype or shape.
    [case for case, (name, *_) in BAD_CONTENT.items() if name not in ("version", "description", "jacobian")],
)
def test_bad_content_names_its_field_when_written_and_leaves_nothing(case: str, tmp_path: Path) -> None:
    name, spoil, words = BAD_CONTENT[case]
    attribute = {"phi_i": "phi_i_rad", "theta_i": "theta_i_rad", "wavelengths": "wavelengths_nm"}.get(
        name, name
    )
    bad = dataclasses.replace(small_file(), **{attribute: spoil(small_fields()[name])})  # type: ignore[arg-type]
    with pytest.raises(FileFormatError, match=f"^bad_spec.bsdf: field '{name}' .*{words}"):
        write_bsdf(tmp_path / "bad_spec.bsdf", bad)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("name", PIPELINE_ORDER)
def test_a_missing_field_is_named(name: str, tmp_path: Path) -> None:
    fields = small_fields()
    del fields[name]
    assert f"'{name}'" in error_of(tmp_path / "x_spec.bsdf", tensor_file(raw(fields)))


def test_spectra_and_rgb_exclude_each_other(tmp_path: Path) -> None:
    both = small_fields() | {"rgb": small_fields(spectral=False)["rgb"]}
    assert "either 'spectra' or 'rgb'" in error_of(tmp_path / "x.bsdf", tensor_file(raw(both)))
    mixed = small_fields(spectral=False) | {"wavelengths": small_fields()["wavelengths"]}
    assert "field 'wavelengths'" in error_of(tmp_path / "x.bsdf", tensor_file(raw(mixed)))


def test_an_rgb_file_has_three_channels(tmp_path: Path) -> None:
    fields = small_fields(spectral=False)
    fields["rgb"] = np.ascontiguousarray(fields["rgb"][:, :, :2])
    assert re.search(
        "'rgb' .*expected 3 along axis 2", error_of(tmp_path / "x.bsdf", tensor_file(raw(fields)))
    )


BAD_HEADERS: dict[str, tuple[str, dict[str, object], str]] = {
    "unknown dtype 0": ("ndf", {"code": 0}, "dtype 0"),
    "unknown dtype 12": ("ndf", {"code": 12}, "dtype 12"),
    "too many axes": ("ndf", {"ndim": 65535}, "cut off"),
    "huge axis": ("spectra", {"shape": (1, 3, 2, 2, 2**63 - 1)}, "ends beyond the file"),
    "product beyond 64 bits": ("spectra", {"shape": (2**32, 2**32, 1, 1, 1)}, "ends beyond the file"),
    "product that is zero but for an overflow": ("spectra", {"shape": (0, 2**62, 2**62, 1, 1)}, "too large"),
    "offset beyond the file": ("vndf", {"offset": 10**6}, "ends beyond the file"),
    "offset beyond 63 bits": ("vndf", {"offset": 2**64 - 4}, "ends beyond the file"),
    "offset in the header": ("ndf", {"offset": 16}, "inside 'header'"),
    "name that is not UTF-8": ("ndf", {"name": b"n\xff"}, "UTF-8"),
    "name that does not print": ("ndf", {"name": b"n\n\x1b[31m"}, "print"),
    "name of another field": ("ndf", {"name": b"sigma"}, "twice"),
    "name longer than the file": ("ndf", {"name_length": 65535}, "UTF-8"),
}


@pytest.mark.parametrize("read", [read_bsdf, read_tensors])
@pytest.mark.parametrize("case", BAD_HEADERS)
def test_a_bad_header_names_its_field(case: str, read: Callable[[Path], object], tmp_path: Path) -> None:
    name, changes, words = BAD_HEADERS[case]
    fields = raw(small_fields())
    number = next(k for k, field in enumerate(fields) if field.name == name.encode())
    fields[number] = dataclasses.replace(fields[number], **changes)  # type: ignore[arg-type]
    text = error_of(tmp_path / "x_spec.bsdf", tensor_file(fields), read)
    shown = {f"field '{name}'", f"field '#{number + 1}'", "field 'sigma'" if "twice" in words else ""}
    assert any(part and part in text for part in shown)
    assert re.search(words, text)


def test_overlapping_fields_are_both_named(tmp_path: Path) -> None:
    fields = raw(small_fields())
    content = tensor_file(fields)
    start = content.index(small_fields()["luminance"].tobytes())
    number = next(k for k, field in enumerate(fields) if field.name == b"luminance")
    fields[number] = dataclasses.replace(fields[number], offset=start - 4)
    text = error_of(tmp_path / "x_spec.bsdf", tensor_file(fields))
    assert "field 'luminance'" in text
    assert "inside 'vndf'" in text


def test_a_file_cut_anywhere_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "x_spec.bsdf"
    content = tensor_file(raw(small_fields()))
    path.write_bytes(content)
    for length in reversed(range(len(content))):
        os.truncate(path, length)
        error_of(path)


def test_a_cut_in_the_data_names_the_field_that_is_cut(tmp_path: Path) -> None:
    fields = small_fields()
    content = tensor_file(raw(fields))
    end = content.index(fields["vndf"].tobytes()) + fields["vndf"].nbytes
    text = error_of(tmp_path / "x_spec.bsdf", content[: end - 1])
    assert text.startswith("x_spec.bsdf: field 'vndf' ")
    assert f"{end - 1} bytes" in text


@pytest.mark.parametrize("count", [0, 1, 11, 13, 1025, 2**32 - 1])
def test_a_wrong_number_of_fields_is_refused(count: int, tmp_path: Path) -> None:
    error_of(tmp_path / "x.bsdf", tensor_file(raw(small_fields()), count=count))


@pytest.mark.parametrize("version", [(0, 9), (1, 1), (2, 0)])
def test_another_version_of_the_format_is_named(version: tuple[int, int], tmp_path: Path) -> None:
    text = error_of(tmp_path / "x.bsdf", tensor_file(raw(small_fields()), version=version))
    assert f"{version[0]}.{version[1]}, expected 1.0" in text


def test_a_file_of_thousands_of_fields_is_refused(tmp_path: Path) -> None:
    many = [Field(b"%d" % k, 1, (0,), b"", offset=0) for k in range(2000)]
    assert "announces 2000 fields, expected at most 1024" in error_of(tmp_path / "x.bsdf", tensor_file(many))


def test_an_error_stays_short_whatever_the_file_holds(tmp_path: Path) -> None:
    long_name = Field(b"n" * 65535, 10, (2**64 - 1,) * 32, b"", offset=2**64 - 1)
    for fields in (
        [long_name],
        [dataclasses.replace(long_name, shape=(2**64 - 1,) * 8)],
        [dataclasses.replace(long_name, shape=(0, *(2**64 - 1,) * 7))],
        [dataclasses.replace(long_name, shape=(0,), offset=0)] * 2,
        [Field(b"%0400d" % k, 1, (0,), b"", offset=0) for k in range(1000)],
    ):
        assert len(error_of(tmp_path / "x.bsdf", tensor_file(fields))) < 400


# --- Other formats, and what is no file ---

ZEMAX = b"#\r\nSource Measured\r\nSymmetry  PlaneSymmetrical\r\nSpectralContent  Monochrome\r\nScatterType  BRDF\r\n"
FOREIGN = [
    (ZEMAX, "Zemax"),
    (ZEMAX.decode().encode("utf-16"), "Zemax"),
    (b"# Synopsys Mini-Diff V2\n" + ZEMAX, "Mini-Diff"),
    (b"version https://git-lfs.github.com/spec/v1\noid sha256:00\n", "Git LFS pointer"),
    (b"\x1f\x8b\x08" + bytes(64), "gzip"),
    (b"tensor_fileX\1\0" + bytes(64), "unknown format"),
    (bytes(range(1, 256)), "unknown format"),
]


@pytest.mark.parametrize(("content", "name"), FOREIGN)
def test_another_format_is_named(content: bytes, name: str, tmp_path: Path) -> None:
    text = error_of(tmp_path / "x.bsdf", content)
    assert re.search(f"found an? .*{name}.*, expected an RGL tensor file", text)


@pytest.mark.parametrize(
    ("name", "error", "words"),
    [
        ("missing.bsdf", MissingFileError, "no such file; expected an RGL tensor file"),
        ("folder.bsdf", FileAccessError, "not a regular file"),
        ("pipe.bsdf", FileAccessError, "not a regular file"),  # to open it would block
        ("empty.bsdf", FileFormatError, "is empty"),
        ("x" * 300 + ".bsdf", MissingFileError, "no such file"),
    ],
)
def test_missing_empty_and_unreadable_paths_raise_one_error(
    name: str, error: type[Exception], words: str, tmp_path: Path
) -> None:
    (tmp_path / "folder.bsdf").mkdir()
    (tmp_path / "empty.bsdf").touch()
    os.mkfifo(tmp_path / "pipe.bsdf")
    with pytest.raises(error, match=words):
        read_bsdf(tmp_path / name)


def test_bytes_that_belong_to_no_field_are_refused(tmp_path: Path) -> None:
    write_bsdf(tmp_path / "x.bsdf", small_file())
    content = (tmp_path / "x.bsdf").read_bytes()
    assert read_bsdf(content + bytes(4096)).bands.count  # padding to a page
    assert "bytes that belong to no field" in error_of(tmp_path / "x.bsdf", content + bytes(100_000))


# --- Writing is atomic ---


def test_a_failed_write_leaves_the_old_file_and_nothing_else(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "x_spec.bsdf"
    write_bsdf(path, small_file())
    before = path.read_bytes()

    def refuse(*_: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "replace", refuse)
    with pytest.raises(UsageError, match="No space left"):
        write_bsdf(path, small_file(azimuths=4))
    assert path.read_bytes() == before
    assert list(tmp_path.iterdir()) == [path]


UNWRITABLE: dict[str, dict[str, object]] = {
    "a version below 0": {"version": (-1, 0)},
    "a version beyond 32 bits": {"version": (2**32, 0)},
    "a description with half a character": {"description": "\ud800"},
    "an extra field under a name of the format": {"extra": {"sigma": np.ones((2, 2), np.float32)}},
    "an extra field of objects": {"extra": {"o": np.array([None])}},
    "an extra field in big-endian order": {"extra": {"o": np.ones(1, ">f4")}},
    "big-endian values": {"ndf": np.ones((2, 2), ">f4")},
}


@pytest.mark.parametrize("case", UNWRITABLE)
def test_what_could_not_be_read_back_is_not_written(case: str, tmp_path: Path) -> None:
    bad = dataclasses.replace(small_file(), **UNWRITABLE[case])  # type: ignore[arg-type]
    with pytest.raises(FileFormatError, match=r"^x\.bsdf: "):
        write_bsdf(tmp_path / "x.bsdf", bad)
    assert list(tmp_path.iterdir()) == []


def test_tensors_of_any_memory_layout_are_written(tmp_path: Path) -> None:
    array = np.arange(24, dtype=np.float32).reshape(2, 3, 4)
    fields = {"fortran": np.asfortranarray(array), "strided": array[:, ::2, ::-1], "scalar": np.array(2.5)}
    write_tensors(tmp_path / "x.bsdf", fields)
    for name, found in read_tensors(tmp_path / "x.bsdf").items():
        assert_same_array(found, fields[name], name)


# --- Fuzzing ---


def header_places(content: bytes) -> list[int]:
    """Where each field has the length of its name, its number of axes, its dtype, its offset and its shape."""
    (count,) = struct.unpack_from("<I", content, 14)
    position, found = PREAMBLE_SIZE, []
    for _ in range(count):
        (length,) = struct.unpack_from("<H", content, position)
        at = position + 2 + length
        (ndim,) = struct.unpack_from("<H", content, at)
        found += [position, at, at + 2, at + 3, *range(at + 11, at + 11 + 8 * ndim, 8)]
        position = at + 11 + 8 * ndim
    return found


def fuzz(path: Path, originals: list[Path], count: int) -> int:
    """Read mutated files; how many were refused. Anything but a valid file or an error of one line fails."""
    rng = random.Random(20261121)
    contents = [original.read_bytes() for original in originals]
    places = [header_places(content) for content in contents]
    messages = []
    for k in range(count):
        which = k % len(contents)
        path.write_bytes(of_bytes(contents[which], rng, places[which]))
        try:
            read_bsdf(path)
        except ManifoldError as error:
            messages.append(str(error))
        path.unlink()  # not truncated: nothing may hold a map of it, but a bug could
    assert all(re.fullmatch(rf"{path.name}.*", message) for message in messages)  # one line
    return len(messages)


def test_damaged_files_raise_nothing_but_our_error(tmp_path: Path) -> None:
    originals = []
    for k, (spectral, azimuths) in enumerate([(True, 1), (False, 1), (True, 3), (False, 4)]):
        originals.append(tmp_path / f"{k}.bsdf")
        write_bsdf(originals[-1], small_file(spectral, azimuths))
    assert (
        fuzz(tmp_path / "fuzzed.bsdf", originals, 5000) > 4000
    )  # the rest is damage that leaves a valid file


@needs_real_files
def test_damaged_real_files_raise_nothing_but_our_error(tmp_path: Path) -> None:
    smallest = sorted(REAL_FILES, key=lambda path: path.stat().st_size)[:2]
    assert fuzz(tmp_path / "fuzzed.bsdf", smallest, 300) > 150
