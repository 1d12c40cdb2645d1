"""Files of reflectances, lights and cameras: which column is read, in which unit, and what is refused."""

from __future__ import annotations

import numpy as np
import pytest

from manifold.core.errors import FileFormatError
from manifold.formats.spectra import read_spectrum

NM = np.arange(400.0, 701.0, 50.0)
R = np.array([0.1, 0.2, 0.3, 0.4, 0.5, 0.55, 0.6])


def table(heads: str, *columns, separator=",", above="") -> str:
    """A text of columns below heads."""
    rows = (separator.join(f"{value:.10g}" for value in row) for row in zip(*columns, strict=True))
    return above + "\n".join([*([heads] if heads else []), *rows]) + "\n"


def decimal_commas(text: str) -> str:
    return text.replace(".", ",")


def argyll(kind: str, norm: float, values) -> str:
    """A spectrum as Argyll writes it."""
    return (
        f'SPECT   \n\nORIGINATOR "Argyll CMS"\nMEAS_TYPE "{kind}"\nSPECTRAL_BANDS "7"\nSPECTRAL_NORM "{norm:f}"\n'
        f"NUMBER_OF_FIELDS 7\nBEGIN_DATA_FORMAT\n{' '.join(f'SPEC_{nm:.0f}' for nm in NM)} \nEND_DATA_FORMAT\n"
        f"NUMBER_OF_SETS 1\nBEGIN_DATA\n{' '.join(map(str, values))} \nEND_DATA\n"
    )


def spdx(quantity: str) -> str:
    """A spectrum of IES TM-27."""
    data = "".join(
        f'<SpectralData wavelength="{nm:g}">{value}</SpectralData>' for nm, value in zip(NM, R, strict=True)
    )
    return (
        '<?xml version="1.0"?><IESTM2714 xmlns="http://www.ies.org/iestm2714" version="1.0"><Header/>'
        f"<SpectralDistribution><SpectralQuantity>{quantity}</SpectralQuantity>{data}</SpectralDistribution>"
        "</IESTM2714>"
    )


def perkin_elmer(unit: str, values) -> str:
    """A spectrum as PerkinElmer's programs export it, wavelengths downwards."""
    rows = table("", NM[::-1], values[::-1], separator="\t")
    head = "PE UV       SUBTECH     SPECTRUM    ASCII       PEDS        4.00\n-1\nX.SP\n#HDR\n-1\n"
    return f"{head}#GR\nnm\n{unit}\n1.0\n#DATA\n{rows}"


SED = "Comment:\nVersion: 2.3\nDate: 01/02/2026,01/02/2026\nWavelength Range: 350,2500\nColumns [4]:\nData:\n"
REFLECTANCES = {
    "no heads": table("", NM, R, separator=" "),
    "percent": table("Wavelength (nm),Reflectance (%)", NM, 100.0 * R),
    "percent between blanks": table("Wavelength (nm)  Reflectance (%)", NM, 100.0 * R, separator="  "),
    "percent of black": table("nm,%R", NM, 100.0 * R),
    "decimal commas": decimal_commas(table("Wellenlänge (nm);Reflexion (%)", NM, 100.0 * R, separator=";")),
    "wavenumbers": table("Wavenumber (cm-1),Reflectance", 1e7 / NM, R),
    "wavenumbers by their unit alone": table("cm^-1;R", 1e7 / NM, R, separator=";"),
    "micrometres": table("Wavelength [\u00b5m],R", NM / 1e3, R),
    "angstroms": table("Wavelength (A),R", 10.0 * NM, R),
    "apparent absorbance": table("Wavelength (nm),log(1/R)", NM, -np.log10(R)),
    "other order": table("Reflectance;Wavelength (nm)", R, NM, separator=";"),
    "uncertainties beside": table("nm,Reflectance,Std. Dev.", NM, R, 0.01 * R),
    "the name of a sample": table("nm,RAL 3000", NM, R),
    "a header in a comment": table("# wavelength reflectance", NM, R, separator="\t").replace("h r", "h\tr"),
    "prose above": table("", NM, 100.0 * R, separator=" ", above="Reflectance in %\n"),
    "a .sed": table(
        "Wvl\tRad. (Ref.)\tRad. (Target)\tReflect. %", NM, R + 1, R + 2, 100.0 * R, separator="\t", above=SED
    ),
    "a .sed with channels": table(
        "Chan.#\tWvl\tNorm. DN (Ref.)\tNorm. DN (Target)\tReflect. [1.0]", np.arange(7.0), NM, R + 1, R + 2, R,
        separator="\t", above=SED,
    ),
    "a text of JASCO": table(
        "XYDATA", 1e7 / NM, 100.0 * R, separator="\t", above="TITLE\tplate\nXUNITS\t1/CM\nYUNITS\t%R\n"
    ),
    "a point behind the unit": table('"Wavelength nm.","R%"', NM, 100.0 * R),
    "a .sp of Argyll": argyll("REFLECTIVE", 100.0, 100.0 * R),
    "a .sp of PerkinElmer": perkin_elmer("%R", 100.0 * R),
    "a .spdx": spdx("reflectance"),
}  # fmt: skip


ECOSTRESS = (
    "Name: paint\nMeasurement: Directional (10 Degree) Hemispherical Reflectance\nFirst Column: X\n"
    "X Units: Wavelength (micrometers)\nY Units: Reflectance (percent)\nNumber of X Values: 7\n\n"
)
USGS = (
    "Spectral library\nline 17 to end:  3-columns of data:\n     wavelength    reflectance    standard deviation\n\n"
    "(      -1.23e34  indicates a deleted number)\n-----\nLawn_Grass (Green)     W1R1Ba AREF\ncopy of r\n"
)
DELETED = "      0.205100      -1.23e34      0.000000\n"
REFLECTANCES |= {
    "ECOSTRESS": table("", NM[::-1] / 1e3, 100.0 * R[::-1], separator="\t", above=ECOSTRESS),
    "ECOSTRESS in percentage": table(
        "", NM[::-1] / 1e3, 100.0 * R[::-1], separator="  ", above=ECOSTRESS.replace("percent", "percentage")
    ),
    "USGS, with deleted points": table("", NM / 1e3, R, 0.0 * R, separator="   ", above=USGS + DELETED)
    + DELETED,
    "a deleted point": table("nm;R", [390.0, *NM], [-1.23e34, *R], separator=";"),
    "micrometres without a head": table("", NM / 1e3, R, separator=" "),
    "micrometres without a unit": table("Wavelength;R", NM / 1e3, R, separator=";"),
    "rows behind tabs": table("", NM, R, separator="\t").replace("\n", "\n\t"),
}


@pytest.mark.parametrize("name", REFLECTANCES)
def test_reflectances_are_read_however_they_are_spelt(name, tmp_path):
    path = tmp_path / "spectrum.txt"
    path.write_text(REFLECTANCES[name], encoding="utf-8")
    nm, values = read_spectrum(path, "reflectance")
    np.testing.assert_allclose(nm, NM, rtol=1e-8)
    np.testing.assert_allclose(values, R, rtol=1e-8)


def test_utf_16_of_spreadsheets_is_read(tmp_path):
    path = tmp_path / "spectrum.txt"
    path.write_text(
        table("Wavelength (nm)\tReflectance (%)", NM, 100.0 * R, separator="\t"), encoding="utf-16"
    )
    np.testing.assert_allclose(read_spectrum(path, "reflectance"), [NM, R])


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (table("Wavelength (nm),Absorbance", NM, R), "columns Absorbance: expected exactly one of reflectance"),
        (table("nm;%T", NM, R, separator=";"), "columns %T: expected exactly one of reflectance"),
        (table("nm,log10 reflectance", NM, R), "expected exactly one of reflectance"),
        (table("nm,K/S", NM, R), "columns K/S: expected exactly one of reflectance"),
        (table("nm,F(R)", NM, R), r"columns F\(R\): expected exactly one of reflectance"),
        (table("nm,first derivative of reflectance", NM, R), "expected exactly one of reflectance"),
        (table("nm,Radiance", NM, R), "columns Radiance: expected exactly one of reflectance"),
        (table("nm,red,blue", NM, R, R), "columns red, blue: expected exactly one of reflectance"),
        (table("nm,R1 reflectance,R2 reflectance", NM, R, R), "expected exactly one of reflectance"),
        (table("", NM, R, R), "3 columns without headings, expected 2"),
        (table("Energy (eV),R", 1239.84 / NM, R), "columns Energy .eV., R: expected one that is called Wave"),
        (table("", 1e7 / NM, R, separator=" ", above="Wavenumber in cm-1, R\n"), "expected a heading for each"),
        (table("", NM, R, separator=" ", above="Absorbance of a dye\n"), "found 'Absorbance of a dye'"),
        (table("XYDATA", NM, R, above="XUNITS\tNANOMETERS\nYUNITS\tABSORBANCE\n"), "columns ABSORBANCE: expected"),
        (table("", NM, R, separator=" ") + table("", NM + 5.0, R, separator=" "), "go back from 700 to 405 nm"),
        (table("", NM[::-1], R, separator=" ") + table("", NM[::-1] + 5.0, R, separator=" "), "back from 400 to 705"),
        (table("nm;Emissivity", NM, R, separator=";"), "columns Emissivity: expected exactly one of reflectance"),
        (table("nm;R", [400.0, *NM], [0.1, *R], separator=";"), "wavelength 400 nm twice, expected one spectrum"),
        (table("Wavelength (um);R", NM, R, separator=";"), r"nm, as the heading 'Wavelength .um.' says, expected 100"),
        (table("", NM, R, above=ECOSTRESS.replace("Reflectance (", "Transmittance (")), "columns Transmittance"),
        (perkin_elmer("A", R), "columns A: expected exactly one of reflectance"),
        (argyll("EMISSION", 1.0, R), "columns emission: expected exactly one of reflectance"),
        (argyll("REFLECTIVE", 1.0, R[1:]), "6 values of 7 bands"),
        (spdx("relative"), "columns power: expected exactly one of reflectance"),
        ("##TITLE=x\n##YUNITS=ABSORBANCE\n400 1\n500 1\n", "found a JCAMP-DX spectrum"),
        ("PEPE2D\0\0\0spectrum", "found a binary spectrum of PerkinElmer"),
    ],
)  # fmt: skip
def test_what_is_no_reflectance_is_refused(text, words, tmp_path):
    path = tmp_path / "spectrum.txt"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(FileFormatError, match=words) as error:
        read_spectrum(path, "reflectance")
    assert "\n" not in str(error.value)


@pytest.mark.parametrize(
    ("text", "is_read"),
    [
        (table("Wavelength (nm);Spectral irradiance (W/m2/nm)", NM, R, separator=";"), True),
        (table("nm relative_power", NM, R, separator=" "), True),
        (spdx("relative"), True),
        (argyll("AMBIENT", 1.0, R), True),
        (table("nm,Photon flux", NM, R), False),
        (table("nm,Reflectance", NM, R), False),
        (table("nm,Counts", NM, R), False),
        (table("Wavenumber (cm-1),Radiance", 1e7 / NM, R), False),  # per wavenumber, not per wavelength
        (table("Wvl\tRad. (Ref.)\tRad. (Target)\tReflect. %", NM, R, R, R, separator="\t", above=SED), False),
    ],
)
def test_lights_are_powers_per_wavelength(text, is_read, tmp_path):
    path = tmp_path / "lamp.txt"
    path.write_text(text)
    if is_read:
        np.testing.assert_allclose(read_spectrum(path, "power"), [NM, R])
    else:
        with pytest.raises(FileFormatError, match="power"):
            read_spectrum(path, "power")


def test_sensitivities_are_ordered_by_their_heads(tmp_path):
    path = tmp_path / "camera.csv"
    path.write_text(table("nm,Blue,Green,Red", NM, R, 2 * R, 3 * R))
    expected = np.stack([3 * R, 2 * R, R], axis=1)
    np.testing.assert_allclose(read_spectrum(path, "sensitivity")[1], expected)
    path.write_text(table("", NM, 3 * R, 2 * R, R, separator=" "))
    np.testing.assert_allclose(read_spectrum(path, "sensitivity")[1], expected)
    path.write_text(table("nm,x,y,z", NM, R, R, R))
    with pytest.raises(FileFormatError, match="columns x, y, z: expected one each of red, green and blue"):
        read_spectrum(path, "sensitivity")


@pytest.mark.parametrize(
    "nm",
    [
        [400.0, 600.0, 850.0, 800.0, 900.0, 1200.0],
        [400.0, 600.0, 850.0, 300.0, 350.0],
        [400.0, 500.0, 450.0, 600.0],
    ],
    ids=["overlapping", "ultraviolet last", "one out of place"],
)
def test_parts_of_one_spectrum_are_joined(nm, tmp_path):
    """Ranges of detectors overlap, and rows may stand in another order."""
    nm = np.array(nm)
    path = tmp_path / "spectrum.txt"
    path.write_text(table("Wavelength (nm),Reflectance", nm, nm / 2000.0))
    found, values = read_spectrum(path, "reflectance")
    np.testing.assert_array_equal(found, np.sort(nm))
    np.testing.assert_allclose(values, np.sort(nm) / 2000.0)
