"""Colour corrections, and readings of two instruments as one."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest
from helpers.readings import DIRECTIONS, readings

from manifold.brdf.measured import MeasuredBRDF
from manifold.colour.conversion import interpolation_matrix
from manifold.colour.correction import learn_correction, read_correction, write_correction
from manifold.colour.reflectances import diffuse_reflectance, diffuse_reflectance_names
from manifold.core.directions import from_spherical
from manifold.core.errors import BandMismatchError, FileFormatError, UsageError
from manifold.core.records import Bands
from manifold.estimate import instruments
from manifold.estimate.instruments import CalibratedInstrument, between_measurements, correct_colours, merge
from manifold.formats import csv_table
from manifold.formats.readings import MA_T12_NAMES, Readings
from manifold.formats.registry import read_readings
from manifold.io_rgl import read_bsdf
from manifold.library.store import Library

CAMERA = Bands((465.0, 525.0, 630.0))


def gonio_directions(elevation_step, azimuths):
    """Direction pairs of a goniometer at four incidences."""
    theta_i, theta_o, phi = (
        a.ravel() for a in np.meshgrid([0, 20, 40, 60], np.arange(0, 75, elevation_step), azimuths)
    )
    wi = from_spherical(np.deg2rad(theta_i.astype(float)), np.pi)
    return wi, from_spherical(np.deg2rad(theta_o.astype(float)), np.deg2rad(phi.astype(float)))


def learn(x, y, **how):
    """A correction between bands that do not matter."""
    return learn_correction(x, y, CAMERA, Bands(tuple(np.linspace(400.0, 700.0, y.shape[1]))), **how)


def test_an_exact_linear_relation_is_found_and_continued_in_proportion(rng):
    x = rng.random((20, 3))
    M = rng.random((3, 5))
    found = learn(x, x @ M)
    assert found.form == "linear"
    np.testing.assert_allclose(found.apply(7.0 * x), 7.0 * x @ M, rtol=1e-9)


def test_overfitting_forms_lose_on_values_left_out(rng):
    x = rng.random((12, 3)) + 0.05
    y = (x @ rng.random((3, 4))) * (1.0 + 0.05 * rng.standard_normal((12, 4)))
    found = learn(x, y)
    assert found.errors["Cheung 2004, 10 terms"] > found.errors["linear"]
    assert found.form in ("linear", "root polynomial of degree 2")
    with pytest.raises(UsageError, match="at least four"):
        learn(x[:3], y[:3])


def test_a_correction_from_few_directions_is_read_as_it_was_written(rng, tmp_path):
    x = rng.random((4, 3)) + 0.1
    learned = learn(x, x @ rng.random((3, 2)))
    assert np.isnan(learned.errors["linear"])  # three terms of four values: none can be left out
    write_correction(tmp_path / "c.json", learned)
    found = read_correction(tmp_path / "c.json")
    assert (found.source, found.reference) == (learned.source, learned.reference)
    assert np.isnan(found.errors["linear"])
    np.testing.assert_array_equal(found.apply(x), learned.apply(x))


@pytest.mark.parametrize(
    ("damage", "message"),
    [
        (bytes(range(128, 256)), "expected a colour correction"),
        (b"{}", "not a colour correction"),
        ({"form": "cubic"}, "its format or form is unknown"),
        ({"matrix": [[1.0]]}, "its matrix has shape"),
        ({"scale": 0.0}, "its scale or largest value is not positive"),
    ],
)
def test_a_file_that_is_no_correction_is_refused_in_one_line(rng, tmp_path, damage, message):
    path, x = tmp_path / "c.json", rng.random((12, 3)) + 0.1
    write_correction(path, learn(x, x))
    if isinstance(damage, bytes):
        path.write_bytes(damage)
    else:
        path.write_text(json.dumps(json.loads(path.read_text()) | damage))
    with pytest.raises(FileFormatError, match=message):
        read_correction(path)


def test_what_one_sample_alone_determines_is_not_left_out(rng):
    """Readings of a sample that are alike in all directions count once: four samples determine three terms, no more."""
    colours = rng.random((4, 3)) + 0.1
    x, groups = np.repeat(colours, 12, axis=0), np.repeat(np.arange(4), 12)
    found = learn(x, x @ rng.random((3, 5)), groups=groups)
    assert list(found.errors) == ["linear"]
    assert found.errors["linear"] == pytest.approx(0.0, abs=1e-9)  # the relation is linear
    few = groups < 3
    assert np.isnan(learn(x[few], x[few], groups=groups[few]).errors["linear"])


def test_samples_are_left_out_whole(rng):
    x, groups = rng.random((12, 3)) + 0.05, np.repeat(np.arange(4), 3)
    y = (x @ rng.random((3, 4))) * (1.0 + 0.05 * rng.standard_normal((12, 4)))
    found = learn(x, y, forms=("linear",), groups=groups)
    norm = np.linalg.norm(y, axis=1, keepdims=True) + 1e-3 * x.max()  # what is darker counts as this dark
    missed = []
    for g in range(4):
        out = groups == g
        M = np.linalg.lstsq((x / norm)[~out], (y / norm)[~out], rcond=None)[0]
        missed.append((x / norm)[out] @ M - (y / norm)[out])
    expected = np.sqrt(np.mean(np.sum(np.vstack(missed) ** 2, axis=1)))
    assert found.errors["linear"] == pytest.approx(expected, rel=1e-6)


def test_a_goniometer_gets_the_colours_of_the_spectrophotometer(library, rng):
    brdf = MeasuredBRDF(Library.open(library).read("syn_felt_green"))
    nm = np.linspace(400.0, 700.0, 31)

    def spectra(wi, wo):
        return np.array([np.interp(nm, [420.0, 550.0, 650.0], row[::-1]) for row in brdf.eval(wi, wo)])

    at = gonio_directions(5, np.arange(0, 181, 20))
    camera = np.array([[0.7, 0.1, 0.1], [0.2, 0.9, 0.1], [0.0, 0.1, 0.5]])
    gonio = readings(brdf.eval(*at) @ camera, at, np.array(CAMERA.wavelengths_nm))
    spectro = readings(spectra(*DIRECTIONS), nm=nm)
    found, correction = merge(spectro, gonio)
    assert correction is not None
    truth = spectra(*at)
    assert np.median(np.abs(found.values[12:] - truth) / truth.max(axis=1, keepdims=True)) < 0.03
    assert found.bands.count == 31
    assert "a leave-one-out error of" in found.notes[-1]
    assert "one sample" not in found.notes[-1]
    of_another = replace(gonio, values=gonio.values[rng.permutation(len(gonio))], name="other")
    mixed, _ = merge(spectro, of_another)
    assert mixed.notes[-1].endswith("do both files read one sample, sample and other?")
    with pytest.raises(BandMismatchError, match="expected three bands, which"):
        merge(spectro, spectro.select_bands(range(5)))


def test_two_instruments_put_together_keep_the_gloss_of_both(rng):
    one, other = (readings(rng.random((12, 3)), gloss=gloss) for gloss in ({60: 3.0}, {60: 9.0, 20: 1.0}))
    merged, correction = merge(one, other)
    assert dict(merged.gloss) == {60: 3.0, 20: 1.0}
    assert correction is None


# -- commands ---------------------------------------------------------------------------------------------------


def test_a_correction_is_learned_across_samples_written_and_applied(run, tmp_path, rng):
    nm = np.arange(400.0, 701.0, 20.0)
    at = gonio_directions(10, [0, 60, 120, 180])
    sensors = rng.random((3, len(nm)))
    names = []
    for k in range(5):
        spectrum = 0.1 + rng.random(3) @ np.array(
            [np.exp(-(((nm - c) / 60.0) ** 2)) for c in (450, 550, 650)]
        )
        csv_table.write(tmp_path / f"s{k}.csv", readings(np.tile(spectrum, (12, 1)), nm=nm))
        camera = np.tile(sensors @ spectrum, (len(at[0]), 1))
        csv_table.write(tmp_path / f"g{k}.csv", readings(camera, at, np.array(CAMERA.wavelengths_nm)))
        names += [f"s{k}.csv", f"g{k}.csv"]
    status, out, err = run("calibrate", *names, "-o", "c.json", cwd=tmp_path)
    assert status == 0, err
    assert "chosen" in out
    learned = read_correction(tmp_path / "c.json")
    made = correct_colours(read_readings(tmp_path / "g3.csv"), learned)
    truth = read_readings(tmp_path / "s3.csv").values[0]
    np.testing.assert_allclose(made.values, np.tile(truth, (len(made), 1)), rtol=0.05)
    with pytest.raises(BandMismatchError, match="another instrument"):
        correct_colours(readings(np.ones((12, 3))), learned)
    status, out, err = run("convert", "g3.csv", "-o", "g3.bsdf", "--correction", "c.json", cwd=tmp_path)
    assert status == 0, err
    spectral = MeasuredBRDF(read_bsdf(tmp_path / "g3.bsdf"))
    assert spectral.bands == learned.reference
    np.testing.assert_allclose(spectral.eval(at[0][5], at[1][5]), truth, rtol=0.05)
    status, _, err = run("convert", "g3.bsdf", "-o", "g4.bsdf", "--correction", "c.json", cwd=tmp_path)
    assert (status, "to correct" in err) == (2, True)
    assert run("calibrate", names[0], cwd=tmp_path)[0] == 2
    for count, words in ((1, "one sample determines"), (3, "3 samples determine")):
        status, out, err = run("calibrate", *names[: 2 * count], "-o", f"c{count}.json", cwd=tmp_path)
        assert status == 0, err
        assert f"note: {words}" in out
        assert ("reading by reading of the one sample" in out) == (count == 1)


def pairs_of_tables(folder, spectra):
    """Write files of samples s0, s1, ... into `reference` and, as three narrow bands see them, `other`."""
    nm, at = np.arange(400.0, 701.0, 20.0), gonio_directions(10, [0, 60, 120, 180])
    sensors = np.exp(-(((nm - np.array([465.0, 525.0, 630.0])[:, None]) / 30.0) ** 2))
    sensors /= sensors.sum(axis=1, keepdims=True)
    for k, spectrum in enumerate(spectra):
        csv_table.write(
            folder / "reference" / f"{k}.csv",
            replace(readings(np.tile(spectrum, (12, 1)), nm=nm), name=f"s{k}"),
        )
        camera = sensors @ spectrum
        one = readings(np.tile(camera, (len(at[0]), 1)), at, np.array(CAMERA.wavelengths_nm))
        csv_table.write(folder / "other" / f"{k}.csv", replace(one, name=f"s{k}"))


@pytest.fixture
def spectra(rng):
    """Ten samples, 400 to 700 nm."""
    nm = np.arange(400.0, 701.0, 20.0)
    humps = np.exp(-(((nm - np.array([450.0, 550.0, 650.0])[:, None]) / 60.0) ** 2))
    return 0.1 + 0.25 * rng.random((10, 3)) @ humps


@pytest.fixture
def folders(tmp_path):
    """`reference` and `other`, empty."""
    for name in ("reference", "other"):
        (tmp_path / name).mkdir()
    return [tmp_path / "reference", tmp_path / "other"]


def test_samples_without_a_pair_are_named_with_their_files(folders, spectra, tmp_path):
    pairs_of_tables(tmp_path, spectra)
    (folders[0] / "8.csv").unlink()
    twice = (folders[1] / "0.csv").read_text()
    (folders[1] / "again.csv").write_text(twice)
    made = instruments.calibrate(folders, tmp_path / "c.json")
    assert made.samples == [f"s{k}" for k in (1, 2, 3, 4, 5, 6, 7, 9)]
    assert made.left_out == (
        f"s0 ({folders[1] / '0.csv'}, {folders[1] / 'again.csv'}), read 2 times in {folders[1]}",
        f"s8 ({folders[1] / '8.csv'}), in {folders[1]} only",
    )
    assert made.notes[0].startswith("2 samples left out: s0 (")
    assert made.to_json()["left_out"] == list(made.left_out)


def test_a_file_of_several_samples_goes_with_a_folder(folders, spectra, tmp_path):
    pairs_of_tables(tmp_path, spectra)
    factors = np.pi * spectra
    rows = [f"s{k},{g},{','.join(map(str, factors[k]))}" for k in range(10) for g in MA_T12_NAMES]
    table = "\n".join([f"Name,Geometry,{','.join(map(str, range(400, 701, 20)))}", *rows])
    (tmp_path / "all.csv").write_text(table)
    made = instruments.calibrate([tmp_path / "all.csv", folders[1]], tmp_path / "c.json")
    assert made.samples == [f"s{k}" for k in range(10)]
    assert made.left_out == ()


def test_a_correction_that_harms_is_written_only_if_asked(run, folders, tmp_path):
    """The spectra are of those that estimates without a correction know; four of them do not determine the fifth."""
    nm = np.arange(400.0, 701.0, 20.0)
    pairs_of_tables(
        tmp_path, [diffuse_reflectance(name, nm) for name in diffuse_reflectance_names()[::26][:5]]
    )
    status, _, err = run("calibrate", *folders, "-o", "c.json", cwd=tmp_path)
    assert status == 2
    assert "not written, the correction is worse than none (" in err
    assert err.count("\n") == 1
    assert not (tmp_path / "c.json").exists()
    status, out, err = run("calibrate", *folders, "-o", "c.json", "--allow-harm", cwd=tmp_path)
    assert status == 0, err
    assert "note: do not use it: " in out
    read_correction(tmp_path / "c.json")


def test_a_correction_that_makes_most_samples_worse_harms(rng):
    x = rng.random((10, 3)) + 0.1
    learned = replace(learn(x, x), uncorrected=1.0)
    made = CalibratedInstrument("c.json", learned, [f"s{k}" for k in range(10)])
    before, after = np.full(10, 2.0), np.full(10, 2.1)
    after[:4] = 0.0  # the mean is better
    harms = replace(made, correction=replace(learned, colours=np.column_stack([before, after])))
    assert harms.harm.startswith("6 samples of 10 become worse: s4 (CIEDE2000, D65/2: 2.0 before, 2.1 after)")
    after[4] = 0.0
    helps = replace(made, correction=replace(learned, colours=np.column_stack([before, after])))
    assert helps.harm is None
    after[9] = 20.0
    shifts = replace(made, correction=replace(learned, colours=np.column_stack([before, after])))
    assert shifts.harm == "mean CIEDE2000 (D65/2) 2.0 without it, 2.8 with it"


def table_of(path, values):
    rows = [f"{name},{g},{v},{v},{v}" for name, v in values.items() for g in MA_T12_NAMES]
    path.write_text("\n".join(["Name,Geometry,465,525,630", *rows]))


def test_samples_of_two_files_are_paired_by_name(tmp_path):
    a, b, c, d = (tmp_path / f"{name}.csv" for name in "abcd")
    table_of(a, {"red": 0.2, "blue": 0.4})
    table_of(b, {"blue": 0.4, "Red": 0.2, "green": 0.3})
    table_of(c, {"other": 0.2})
    table_of(d, {"another": 0.2})

    def names(*paths):
        pairs, left_out = instruments.pairs_of(*paths)
        return [(x.name, y.name) for x, y in pairs], left_out

    assert names(a, b) == ([("red", "Red"), ("blue", "blue")], [f"green ({b}), in {b} only"])
    assert names(c, d) == ([("other", "another")], [])
    with pytest.raises(
        UsageError, match=r"no sample has the same name in both; found red \(.*a\.csv only; blue"
    ):
        instruments.pairs_of(a, c)
    with pytest.raises(UsageError, match=r"a\.csv is given twice"):
        instruments.pairs_of(a, a)


def test_a_sample_is_chosen_of_every_file_with_several(run, tmp_path):
    table_of(tmp_path / "one.csv", {"own": 0.2})
    table_of(tmp_path / "several.csv", {"red": 0.2, "blue": 0.4})
    both = [tmp_path / "several.csv", tmp_path / "one.csv"]
    for files in (both, both[::-1]):
        assert instruments.read(files, "blue")[0].values.max() == pytest.approx(0.4 / np.pi)
    with pytest.raises(UsageError, match="no sample 'blue'; it holds own"):
        instruments.read(both[1:], "blue")
    with pytest.raises(UsageError, match="no file holds a sample 'blue', but own; name another"):
        instruments.read([both[1]] * 2, "blue")
    with pytest.raises(UsageError, match="no sample 'own'; it holds red, blue"):
        instruments.read(both[::-1], "own")
    for name in ("red", "blue"):
        status, out, err = run(
            "fit", "several.csv", "--sample", name, "--free", "base_color", "-o", "x.fit.json", cwd=tmp_path
        )
        assert (status, "up to date" in out) == (0, False), err
        assert json.loads((tmp_path / "x.fit.json").read_text())["source"]["name"] == name
    status, _, err = run("fit", "several.csv", "-o", "x.fit.json", cwd=tmp_path)
    assert (status, err.count("several.csv")) == (1, 1)
    for given in (["-o", "x_rgb.bsdf"], ["--gloss", "60=20"]):
        status, _, err = run("complete", "several.csv", *given, cwd=tmp_path)
        assert status == 2
        assert "2 samples (red, blue); name one by --sample" in " ".join(err.split())


def test_the_picture_of_several_samples_is_their_sheet(run, tmp_path):
    table_of(tmp_path / "several.csv", {"red": 0.2, "blue": 0.4})
    status, _, err = run(
        "complete", "several.csv", "--picture", "--resolution", "4", "--incidences", "4", "--workers", "1",
        cwd=tmp_path,
    )  # fmt: skip
    assert status == 0, err
    assert (tmp_path / "completions" / "completions.png").is_file()


def test_a_correction_says_whether_it_is_better_than_none(rng, tmp_path):
    """A sensor that is not linear is worth correcting; readings of other samples teach nothing."""
    nm = np.arange(400.0, 701.0, 10.0)
    spectra = np.array([diffuse_reflectance(name, nm) for name in diffuse_reflectance_names()])
    narrow = Bands((465.0, 525.0, 630.0))
    read = (spectra @ interpolation_matrix(nm, np.array(narrow.wavelengths_nm)).T) ** 1.2
    good = learn_correction(read, spectra, narrow, Bands(tuple(nm)))
    assert good.errors[good.form] < 0.8 * good.uncorrected
    assert good.colours.shape == (len(read), 2)
    assert np.median(good.colours[:, 1]) < 0.5 * np.median(good.colours[:, 0])
    assert good.is_worse.mean() <= 0.25
    names = [f"sample {k}" for k in range(len(read))]
    worst = np.argmax(good.colours[:, 1] - good.colours[:, 0])
    assert f"become worse: {names[worst]} (CIEDE2000" in CalibratedInstrument(tmp_path, good, names).notes[0]
    wrong = learn_correction(read, spectra[rng.permutation(len(spectra))], narrow, Bands(tuple(nm)))
    assert wrong.errors[wrong.form] > 5.0 * good.errors[good.form]
    estimated = replace(wrong, uncorrected=0.9 * wrong.errors[wrong.form])
    assert (
        CalibratedInstrument(tmp_path, estimated, names)
        .notes[1]
        .startswith(
            f"do not use it: leave-one-out error {wrong.errors[wrong.form]:.4f}, without a correction"
        )
    )


# -- measurements of one sample -------------------------------------------------------------------------------------


def measured_again(rng, spreads, repeatability, n=400):
    """Measurements of a grey sample at the same pairs, each off by its own error and noise of its repeatability."""
    wi = from_spherical(np.full(n, 0.6), np.pi)
    wo = from_spherical(np.linspace(0.0, 1.3, n), 0.0)
    true = 0.2 + 0.1 * np.linspace(0.0, 1.0, n)[:, None] * np.ones(3)
    return [
        Readings(
            "grey", f"device {k}", wi, wo, None,
            true * (1.0 + spread * rng.standard_normal((n, 1)) + repeatability * rng.standard_normal((n, 3))),
            repeatability=repeatability,
        )
        for k, spread in enumerate(spreads)
    ]  # fmt: skip


def test_the_deviation_between_measurements_is_found_beyond_what_each_repeats(rng):
    parts = measured_again(rng, (0.05, 0.05, 0.05), 0.01)
    found = between_measurements(parts)
    assert found.deviation == pytest.approx(0.05, rel=0.08)
    assert found.pairs == 400
    # With equal variances within, Mandel and Paule's equation has a closed form.
    values = np.array([part.values for part in parts])
    relative = values / values.mean(axis=0) - 1.0
    closed = np.sqrt(np.sum(relative**2) / (400 * 3 * 2) - 0.01**2)
    assert found.deviation == pytest.approx(closed, rel=1e-3)


def test_measurements_that_agree_as_each_repeats_differ_by_nothing_more(rng):
    found = between_measurements(measured_again(rng, (0.0, 0.0), 0.02))
    assert found.deviation < 0.004
    alone = readings(np.full((12, 3), 0.2))
    assert between_measurements([alone, alone]).deviation == 0.0
    assert (
        between_measurements([alone.select_pairs(np.arange(6)), alone.select_pairs(np.arange(6, 12))]) is None
    )


def test_differences_between_two_measurements_become_the_repeatability(run, library, tmp_path):
    for k, factor in enumerate((0.95, 1.05)):
        csv_table.write(tmp_path / f"at_{k}.csv", readings(np.full((12, 3), 0.2 * factor)))
    status, out, err = run(
        "complete", "at_0.csv", "at_1.csv", "--merge", "-L", library, "-o", "made_rgb.bsdf", "--json", "made.json",
        cwd=tmp_path,
    )  # fmt: skip
    assert status == 0, err
    found = json.loads((tmp_path / "made.json").read_text())
    # Two values, 10 % apart: their standard deviation is 10 % over the root of two.
    assert found["between_measurements"]["deviation"] == pytest.approx(0.1 / np.sqrt(2.0), rel=0.01)
    assert found["repeatability"] > 0.07
    assert "between measurements" in out
