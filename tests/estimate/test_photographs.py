"""`manifold photograph`: from a picture to a file."""

from __future__ import annotations

import json
from dataclasses import replace
from html import unescape

import numpy as np
import pytest
import tifffile
from helpers.small_library import measured, spectral_files
from PIL import Image

from manifold.analytic import corpus
from manifold.brdf.measured import MeasuredBRDF
from manifold.colour.conversion import encode_srgb, interpolation_matrix
from manifold.colour.lights import environment
from manifold.colour.picture_files import read_picture
from manifold.core.directions import from_spherical
from manifold.core.errors import UsageError
from manifold.core.records import Bands
from manifold.estimate import completions, descriptions, photographs, sightings
from manifold.estimate.attributes import lab_of
from manifold.estimate.channels import read_responses
from manifold.estimate.gloss import gloss_units
from manifold.formats.readings import Readings, geometry_ma_t12
from manifold.io_rgl import read_bsdf, write_bsdf
from manifold.library.importing import import_files
from manifold.model.comparison import brdf_errors
from manifold.model.manifold import Manifold
from manifold.model.output_file import OutputOptions
from manifold.model.prediction import ClippedBRDF
from manifold.model.settings import BlendSettings
from manifold.pictures import figures
from manifold.render.images import write_image
from manifold.render.render import render_floating_ball


@pytest.fixture(scope="module")
def folder(tmp_path_factory, library):
    """A photograph of satin gold, linear and in 8 bits, and its light."""
    made = tmp_path_factory.mktemp("photographs")
    light = environment("studio", 128)
    write_bsdf(made / "gold_rgb.bsdf", measured("syn_satin_gold"))
    ball = render_floating_ball(
        made / "gold_rgb.bsdf", True, light, size=128, samples=32, margin=0.3, distance=8.0
    )
    write_image(made / "ball.exr", ball)
    write_image(made / "light.exr", light)
    write_image(made / "negative.exr", light - 0.25 - light.min())
    Manifold.fit(library, BlendSettings()).save(made / "model.h5")
    return made


def test_a_photograph_is_completed(run, folder, library):
    code, out, err = run(
        "photograph", "ball.exr", "--light", "light.exr", "--distance", 8, "--library", library,
        "-o", "found.bsdf", "--picture", "--json", "found.json", "--report", "found.html", cwd=folder,
    )  # fmt: skip
    assert code == 0, err
    truth, found = (MeasuredBRDF(read_bsdf(folder / name)) for name in ("gold_rgb.bsdf", "found.bsdf"))
    assert brdf_errors(truth, found).ball < 2.0
    assert (folder / "found.png").stat().st_size > 10_000
    document = json.loads((folder / "found.json").read_text())
    assert document["photographs"][0]["circle"] == pytest.approx([64, 64, 64 / 1.3], abs=1.0)
    assert document["photographs"][0]["predicted"] is None  # there are no others
    assert document["plausibility"]["max_albedo"] <= 1.05
    assert set(document["expected"]) == {"ball", "cube_root", "linear", "near_mirror", "elsewhere"}
    assert "expected error" in out
    page = (folder / "found.html").read_text()
    assert page.count("data:image/png;base64") == 3  # two balls, and the photograph beside its prediction
    for angle, units in document["gloss"].items():
        assert f"<td>{angle}</td><td>{units['completed']:.3g}</td>" in page
    assert document["alternatives"][0]["like"][0][0] in page.partition("Most probable mixtures")[2]
    assert "predicted from the others" in out
    assert any(line.startswith("ball.exr ") for line in out.splitlines())
    assert sum(one["probability"] for one in document["alternatives"]) <= 1.0 + 1e-9
    assert (document["readings"], document["misfits"]) == (None, None)
    assert all(note in unescape(page) for note in document["diagnostics"])


def test_readings_photograph_and_gloss_are_one_estimate(run, folder, library):
    truth = MeasuredBRDF(read_bsdf(folder / "gold_rgb.bsdf"))
    units = gloss_units(truth, [60.0])[60.0]
    code, out, err = run(
        "photograph", "ball.exr", "--lab", "{:.2f},{:.2f},{:.2f}".format(*lab_of(truth)), "--gloss", f"60={units:.1f}",
        "--light", "light.exr", "--distance", 8, "--library", library,
        "-o", "together.bsdf", "--json", "together.json", cwd=folder,
    )  # fmt: skip
    assert code == 0, err
    found = MeasuredBRDF(read_bsdf(folder / "together.bsdf"))
    assert brdf_errors(truth, found).ball < 2.0
    document = json.loads((folder / "together.json").read_text())
    assert document["gloss"]["60"]["read"] == pytest.approx(units, abs=0.05)
    assert (document["readings"], len(document["misfits_ciede2000"])) == (1, 1)
    assert "% predicted from only the photographs" in " ".join(out.split())


def test_errors_of_a_located_photograph_are_those_of_the_physical_file(folder, library):
    request = sightings.PhotoRequest([folder / "ball.exr"], ["studio"], ["64,64,49.2"], distance=8.0)
    found = descriptions.locate_photographs(
        folder / "model.h5", request, folder / "physical.bsdf", library=library,
        options=OutputOptions(physical=True),
    )  # fmt: skip
    written = MeasuredBRDF(read_bsdf(found.path))
    assert found.located.errors == brdf_errors(ClippedBRDF(found.completion.brdf), written)


@pytest.fixture(scope="module")
def spectral_library(tmp_path_factory):
    """A library of the materials in 15 bands, beside the files."""
    made = tmp_path_factory.mktemp("spectral")
    (made / "files").mkdir()
    for name, file in spectral_files().items():
        thin = replace(file, wavelengths_nm=file.wavelengths_nm[::4], spectra=file.spectra[:, :, ::4])
        write_bsdf(made / "files" / f"{name}_spec.bsdf", thin)
    import_files(made / "library.zarr", [made / "files"])
    return made / "library.zarr"


@pytest.mark.parametrize("kind", ["library", "spectral_library"])
def test_readings_give_the_spectra_beside_a_photograph(kind, folder, tmp_path, request):
    """The spectrum of gold, from few readings far from the highlight, and its highlight from the picture."""
    gold = next(m for m in corpus.isotropic_materials() if m.name == "syn_satin_gold")
    nm = np.arange(400.0, 701.0, 10.0)
    truth, (wi, wo) = gold.truth(Bands(tuple(nm.tolist()))), geometry_ma_t12()
    pictures = sightings.PhotoRequest([folder / "ball.exr"], ["studio"], ["64,64,49.2"], distance=8.0)
    seen = Readings("gold", "simulated", wi, wo, nm, truth.eval(wi, wo))
    found = completions.complete(
        request.getfixturevalue(kind), seen, tmp_path / "x.bsdf", pictures=pictures
    ).completion.brdf
    expected = nm if kind == "library" else np.linspace(400.0, 700.0, 60)[::4]
    np.testing.assert_allclose(found.bands.wavelengths_nm, expected, rtol=1e-6)
    half = (
        from_spherical(np.deg2rad([20.0, 45.0, 45.0]), np.pi),
        from_spherical(np.deg2rad([20.0, 45.0, 0.0]), 0.0),
    )
    made = found.eval(*half) @ interpolation_matrix(expected, nm).T
    shape, of_truth = (f / f.mean(axis=1, keepdims=True) for f in (made, truth.eval(*half)))
    np.testing.assert_allclose(
        shape, of_truth, atol=0.12
    )  # a line between nodes of 21 nm, of a steep spectrum
    np.testing.assert_allclose(made.mean(axis=1), truth.eval(*half).mean(axis=1), rtol=0.2)


def test_a_camera_is_described_by_its_sensitivities(run, tmp_path, spectral_library):
    """Its picture is that of RGB files of what its channels see of the spectra, in a light without colour."""
    nm = np.arange(400.0, 701.0, 5.0)
    curves = np.exp(-(((nm[:, None] - [590.0, 550.0, 460.0]) / 35.0) ** 2))
    np.savetxt(tmp_path / "curves.csv", np.column_stack([nm, curves]), delimiter=",", header="nm,r,g,b")
    truth = read_bsdf(spectral_library.parent / "files" / "syn_satin_gold_spec.bsdf")
    responses = read_responses(tmp_path / "curves.csv", Bands(tuple(truth.wavelengths_nm.tolist())))
    seen = np.einsum("cb,pibxy->picxy", responses, truth.spectra).astype(np.float32)
    write_bsdf(tmp_path / "seen_rgb.bsdf", replace(measured("syn_satin_gold"), spectra=seen))
    light = environment("overcast", 128)
    ball = render_floating_ball(
        tmp_path / "seen_rgb.bsdf", True, light, size=96, samples=32, margin=0.3, distance=8.0
    )
    write_image(tmp_path / "ball.exr", ball)
    errors = {}
    for camera in ((), ("--camera", "curves.csv")):
        code, _, err = run(
            "photograph", "ball.exr", "--light", "overcast", "--distance", 8, "--circle", "48,48,36.9",
            "--library", spectral_library, *camera, "-o", "found_spec.bsdf", cwd=tmp_path,
        )  # fmt: skip
        assert code == 0, err
        found = MeasuredBRDF(read_bsdf(tmp_path / "found_spec.bsdf"))
        errors[camera] = brdf_errors(MeasuredBRDF(truth), found).ball
    assert errors["--camera", "curves.csv"] < min(3.0, 0.5 * errors[()])


@pytest.mark.parametrize(
    ("values", "words"),
    [
        (np.ones((64, 64, 3)), "every pixel is clipped"),
        (np.full((64, 64, 3), np.nan), "every pixel is clipped"),
        (np.full((64, 64, 3), 0.5) + 0.01 * np.random.default_rng(0).random((64, 64, 3)), "no ball found"),
    ],
)
def test_pictures_without_a_ball_end_in_one_line(run, folder, library, values, words):
    tifffile.imwrite(folder / "bad.tif", values.astype(np.float32), photometric="rgb")
    code, _, err = run(
        "photograph",
        "bad.tif",
        "--light",
        "studio",
        "--library",
        library,
        "-o",
        "x.bsdf",
        cwd=folder,
    )
    assert code in (1, 2)
    assert words in " ".join(err.split())


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["ball.exr"], "no light is given; use --lamp"),
        (["ball.exr", "--light", "nowhere.exr"], "no such file"),
        (["ball.exr", "--light", "ball.exr"], "twice as wide"),
        (["light.exr", "--light", "studio", "--circle", "900,10,40"], "expected one inside it"),
        (["ball.exr", "--light", "negative.exr"], "negative light, down to -0.25"),
        (["ball.exr", "--light", "studio", "--circle", "64,64,1e300"], "a radius from 8 pixels"),
        (["ball.exr", "--light", "studio", "--turn", "nan"], "expected finite angles"),
        (
            ["ball.exr", "--light", "studio", "--elevation", "nan"],
            "elevation",  # of which some versions of Typer say that it is out of range
        ),
        (["ball.exr", "--light", "studio", "--distance", "nan"], "more than 1"),
        (["ball.exr", "--light", "studio", "--distance", "1e300"], "at most 1e+06"),
        (["ball.exr", "--lamp", "0,0,-1"], "ball.exr (0.000,0.000,-1.000): the lamp is behind the ball"),
        (
            ["ball.exr", "--lamp", "lamps.txt"],
            "lamps.txt: no such file; name a text of lines X Y Z, or give X,Y,Z",
        ),
        (
            ["ball.exr", "--lamp", "0,1,0", "--cylinder", "64,64,40,80"],
            "lights no part of the ball that the camera sees",
        ),
        (["ball.exr", "--lamp", "0,0,1,1e200"], "expected 1.2 to 1e+06, or none"),
        (["ball.exr", "--lamp", "found", "--circle", "-500,0,10"], "expected one inside it"),
        (["ball.exr", "--light-ball", "ball.exr@-500,0,10"], "expected one inside it"),
        (
            ["ball.exr", "--light-ball", "ball.exr@5,64,40"],
            "of the mirror ball at 5.0,64.0,40.0 lies outside",
        ),
        (["ball.exr", "--light", "studio", "--exposure", "bright"], "or 'free'"),
        (["ball.exr", "--light", "studio", "--turn", 1, "--turn", 2], "2 turns for 1 photograph,"),
        (["ball.exr", "--light", "studio", "--camera", "curves.csv"], "spectral library"),
    ],
)
def test_what_cannot_be_used_is_refused_in_one_line(run, folder, library, arguments, words):
    code, _, err = run("photograph", *arguments, "--library", library, "-o", "x.bsdf", cwd=folder)
    assert code in (1, 2)
    assert words in " ".join(err.split())
    assert not (folder / "x.bsdf").exists()


@pytest.mark.parametrize("name", ["light.png", "clipped.exr", "light.exr"])
def test_a_light_of_display_values_and_clipped_lamps_are_said(folder, name):
    values = environment("studio", 64)
    clipped = np.minimum(values, 1.0)
    Image.fromarray(np.round(255 * encode_srgb(clipped)).astype(np.uint8)).save(folder / "light.png")
    write_image(folder / "clipped.exr", clipped)
    (ball,) = sightings.see(
        sightings.PhotoRequest([folder / "ball.exr"], [str(folder / name)], ["64,64,49.2"])
    )
    count = np.count_nonzero((clipped == 1.0).any(axis=2))
    assert count > 100
    told = {note.split("; ")[0] for note in ball.notes}
    is_clipped = name != "light.exr"
    assert (f"{name}: its {count} brightest pixels have the same value" in told) == is_clipped
    assert (f"{name}: read as sRGB" in told) == (name == "light.png")


@pytest.mark.parametrize("name", ["$x^$_{.png", "a\nb\\$.png", "$" * 300])
def test_names_of_pictures_are_no_formulas(name, tmp_path):
    ball = np.full((8, 8, 3), 0.5)
    figure = photographs.residual_figure([name], [ball], [ball], [np.zeros((8, 8))])
    figures.save(figure, tmp_path / "residuals.png")
    assert (tmp_path / "residuals.png").stat().st_size > 0


def test_the_light_of_a_picture_without_the_lamp_is_subtracted(folder, tmp_path):
    lit = read_picture(folder / "ball.exr").values
    write_image(tmp_path / "both.exr", lit + 0.05)
    write_image(tmp_path / "off.exr", np.full_like(lit, 0.05))
    request = sightings.PhotoRequest(
        [tmp_path / "both.exr"], ["studio"], ["64,64,49.2"], distance=8.0, dark=tmp_path / "off.exr"
    )
    (ball,) = sightings.see(request)
    np.testing.assert_allclose(ball.photograph.values, lit, atol=1e-3 * lit.max())  # of half floats
    write_image(tmp_path / "small.exr", lit[:-8, :-8])
    with pytest.raises(UsageError, match=r"small\.exr: of another size than the photographs"):
        sightings.see(replace(request, dark=tmp_path / "small.exr"))


def test_an_estimated_exposure_is_reported_and_leaves_the_shown_photograph_unchanged(
    folder, library, tmp_path, monkeypatch
):
    shown = []

    def record(names, seen, predicted, errors):
        shown.append((seen[0], predicted[0]))
        return figure(names, seen, predicted, errors)

    figure = photographs.residual_figure
    monkeypatch.setattr(photographs, "residual_figure", record)
    dark = 0.1 * read_picture(folder / "ball.exr").values
    write_image(tmp_path / "dark.exr", dark)
    request = sightings.PhotoRequest([tmp_path / "dark.exr"], ["studio"], ["64,64,49.2"], distance=8.0)
    for exposure in (None, 0.1):
        found = completions.complete(
            library, None, tmp_path / "x.bsdf", pictures=replace(request, exposure=exposure),
            picture=tmp_path / "x.png",
        )  # fmt: skip
        seen, predicted = shown.pop()
        inside = np.hypot(*np.meshgrid(*[np.linspace(-1.05, 1.05, len(seen))] * 2)) < 0.9
        expected = dark / (exposure or 1.0)
        assert np.nanmax(seen) == pytest.approx(expected.max(), rel=1e-3)  # of half floats
        assert predicted[inside].mean() == pytest.approx(
            seen[inside].mean(), rel=0.1
        )  # noise, and the residual
        assert any("exposure was estimated" in note for note in found.diagnostics) == (exposure is None)
