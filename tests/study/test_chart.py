"""The chart of settings on a small library: complete, consistent, and drawn so that a person sees it."""

import json
import re
import warnings
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from helpers import reference, small_library
from matplotlib.colors import to_rgb
from typer.testing import CliRunner

from manifold.brdf.measured import MeasuredBRDF
from manifold.brdf.unmeasured_cells import fill_unmeasured
from manifold.cli.main import app
from manifold.core import progress
from manifold.core.errors import UsageError
from manifold.core.metrics import Errors
from manifold.core.pairs import RusinkiewiczGrid
from manifold.evaluate import held_out, methods, seen_fits, storage_forms
from manifold.evaluate.held_out import ChartRow, HeldOut, without_small_weights
from manifold.evaluate.method_data import Data
from manifold.evaluate.methods import AFTER_PUBLISHED, PUBLISHED, chart_methods, fit_nearest
from manifold.evaluate.stopwatch import RelativeTime, Stopwatch, some_pairs
from manifold.library.store import Library
from manifold.model.combination import Combination
from manifold.model.manifold import Manifold
from manifold.model.settings import BlendSettings
from manifold.pictures import figures
from manifold.registries import MAPPINGS
from manifold.study import chart_figure
from manifold.study.chart import COSTS, ERRORS, Chart, conclusion, cost_of, fronts, make_chart

FILES = [small_library.measured(name) for name in small_library.NAMES[1:]]
HELD_OUT = [s.key for s in chart_methods(3)]
GRID = RusinkiewiczGrid(18, 9, 6)


@pytest.fixture(scope="module", autouse=True)
def one_lap(short_search):
    """Every time is measured once, not five times: no claim here is about small differences of times."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(held_out, "_REPEATS", 1)
        yield


@pytest.fixture(scope="module")
def made(one_lap):
    return make_chart(FILES, [*HELD_OUT, "fit_gauss-newton"], grid=GRID, fitted=1)


@pytest.fixture(scope="module")
def rows(made):
    return {row.key: row for row in made.rows}


def test_settings_are_unique_and_those_of_spectra_contain_those_of_rgb():
    assert len(HELD_OUT) == len(set(HELD_OUT))
    assert {s.key for s in chart_methods(195)} > set(HELD_OUT)


def test_the_json_has_every_setting_with_finite_measures(made):
    document = json.loads(json.dumps(made.to_json(), allow_nan=False))
    assert [row["key"] for row in document["rows"]] == [*HELD_OUT, "fit_gauss-newton"]
    for row in document["rows"]:
        numbers = [row["median"][k] for k in ERRORS] + [
            row["bytes"],
            row["fit"]["median"],
            row["predict"]["median"],
        ]
        assert min(numbers) > 0, row["key"]
        assert all(row["p90"][name] >= row["median"][name] for name in ERRORS)
        assert min(row[k]["spread"] for k in ("fit", "predict")) >= 0, row["key"]


def test_settings_with_a_map_have_its_detour_and_those_that_share_a_fit_share_it(rows, tmp_path):
    with_maps = {key for key, row in rows.items() if row.coherence is not None}
    assert with_maps == {key for key in rows if key.split("_")[0] in ("published", "pca", "gplvm", "blend")}
    assert rows["blend_2_half"].coherence == rows["blend_2"].coherence
    library = small_library.small_library(tmp_path, names=small_library.NAMES[1:])
    model = Manifold.fit(library, BlendSettings(2))
    for name, value in rows["blend_2"].coherence.statistics.items():
        assert value == pytest.approx(model.coherence.statistics[name], rel=1e-3)  # steps of the layout


@pytest.mark.parametrize("cost", COSTS)
def test_the_published_setting_costs_more_than_its_own_method_without_the_dense_grid(rows, cost):
    assert cost_of(rows[PUBLISHED], cost) > cost_of(rows["gplvm_2_identity"], cost)


def test_a_fit_of_the_seen_material_is_on_no_front(made, rows):
    assert not rows["fit_gauss-newton"].is_held_out
    assert all(
        "fit_gauss-newton" not in keys for by_cost in made.fronts.values() for keys in by_cost.values()
    )


def test_an_interrupted_chart_is_continued_and_a_finished_one_measured_again(one_lap, tmp_path):
    library = Library.open(small_library.small_library(tmp_path))
    keys, done = ["nearest", "pca_6_cube-root_over_0.03", "fit_gauss-newton"], []

    def chart(only=keys, stop_at=None):
        done.clear()

        def step(count, total, title):
            done.append(count)
            if count == stop_at:
                raise KeyboardInterrupt

        with progress.listen(step):
            return make_chart(FILES, only, GRID, 1, library=library)

    for count in (1, 2):
        with pytest.raises(KeyboardInterrupt):
            chart(stop_at=count)
        assert done == [count]
    chart(keys[:1])
    assert done == [1]  # another chart shares nothing with it
    whole = chart()
    assert done == [3]
    assert [row.key for row in whole.rows] == keys
    again = chart()
    assert done == [1, 2, 3]
    for row, other in zip(whole.rows, again.rows, strict=True):
        for name in ("title", "family", "median", "bytes", "warnings", "is_held_out"):
            assert getattr(row, name) == getattr(other, name)
        assert isinstance(row.predict, RelativeTime)


def test_a_chart_of_few_settings_has_numbers_that_do_not_overlap(made):
    few = tuple(row for row in made.rows if row.key in ("nearest", "pca_2_identity"))
    figure = chart_figure.chart(replace(made, rows=few, fronts=fronts(few)))
    for axes in figure.axes:
        for axis, limits in ((axes.xaxis, axes.get_xlim()), (axes.yaxis, axes.get_ylim())):
            shown = [
                tick.label1.get_window_extent()
                for tick in [*axis.get_major_ticks(), *axis.get_minor_ticks()]
                if limits[0] <= tick.get_loc() <= limits[1] and tick.label1.get_text()
            ]
            assert shown
            assert not any(a.overlaps(b) for k, a in enumerate(shown) for b in shown[:k])


def test_halves_take_half_the_bytes_at_nearly_the_same_errors(rows):
    whole, half = rows["gplvm_6_cube-root"], rows["gplvm_6_cube-root_half"]
    assert 0.49 < half.bytes / whole.bytes < 0.51
    assert half.median.linear == pytest.approx(whole.median.linear, rel=0.01)  # float16 keeps 11 bits
    assert half.median.ball == pytest.approx(whole.median.ball, rel=0.05)


def test_compact_storage_takes_few_bytes_at_nearly_the_same_errors(rows):
    whole, compact = rows["blend_2"], rows["blend_2_compact"]
    assert compact.bytes < 0.1 * whole.bytes
    assert compact.median.linear == pytest.approx(whole.median.linear, rel=0.1)
    assert compact.median.ball == pytest.approx(whole.median.ball, abs=0.2)  # the tolerance


def test_one_slow_tabulation_does_not_change_the_time_of_fits(monkeypatch):
    tabulating = iter([90.0, 3.0, 2.0])

    def lap(self, work):
        is_tabulating = getattr(work, "func", None) == Data.evaluate
        return work(), next(tabulating) if is_tabulating else 1.0

    monkeypatch.setattr(held_out, "_REPEATS", 3)
    monkeypatch.setattr(Stopwatch, "lap", lap)
    nearest = chart_methods(3)[0]
    fit = HeldOut(FILES, GRID, [nearest]).measure(nearest).fit
    assert fit.median == 1.0 + 3.0
    assert next(tabulating, None) is None


def test_eq_22_counts_all_bands_and_all_direction_pairs():
    files = list(small_library.spectral_files().values())[:2]
    held, (wi, wo, above) = HeldOut(files, GRID, [chart_methods(60)[0]]), GRID.directions()
    f, f_star = (MeasuredBRDF(fill_unmeasured(file)).eval(wi[above], wo[above]) for file in files)
    assert held.data.f.shape[2] < f.shape[1] == 60
    expected = reference.rmse(f, f_star) * np.sqrt(above.sum() / GRID.n_pairs)
    found = held.errors(0, held.data.f[1], held.balls.on_ball.f[1]).rmse
    assert found == pytest.approx(expected, rel=0.01)  # these spectra are linear between three bands


def test_small_weights_are_dropped_and_the_others_keep_their_proportions_and_the_sum_of_all():
    whole = Combination(MAPPINGS["cube-root"], np.array([0.6, -0.3, 0.05, 0.5, -0.02, 0.17]))
    found = without_small_weights(whole, 0.1).weights
    np.testing.assert_array_equal(found[[2, 4]], 0.0)
    kept = [0, 1, 3, 5]
    np.testing.assert_allclose(found[kept] / found[0], whole.weights[kept] / whole.weights[0])
    assert found.sum() == pytest.approx(whole.weights.sum())


def test_weights_that_hardly_sum_to_anything_without_the_small_ones_are_not_scaled():
    whole = Combination(MAPPINGS["cube-root"], np.array([1.0, -0.99, *[0.09] * 11]))
    np.testing.assert_array_equal(without_small_weights(whole, 0.1).weights[:2], [1.0, -0.99])


def test_every_second_row_and_column_leaves_a_quarter_of_the_bytes(rows):
    whole, coarse = rows["gplvm_6_cube-root"], rows["gplvm_6_cube-root_angles_2_1"]
    assert 0.24 < coarse.bytes / whole.bytes < 0.3  # sigma and ndf are few and stay


def test_the_more_bands_are_kept_the_nearer_a_spectral_file_is_to_all_of_them():
    nm = np.linspace(400.0, 700.0, 16)
    rgb = FILES[0]
    spectra = np.repeat(rgb.spectra[:, :, 1:2], 16, axis=2) * (1.0 + 0.5 * np.sin(nm / 60.0))[:, None, None]
    file = type(rgb)(
        **{f: getattr(rgb, f) for f in rgb.__dataclass_fields__}
        | {"spectra": spectra.astype(np.float32), "wavelengths_nm": nm.astype(np.float32), "version": (3, 1)}
    )
    pairs = some_pairs(50)
    f = MeasuredBRDF(file).eval(pairs.wi, pairs.wo)
    errors = []
    for count in (3, 6, 12):
        kept = MeasuredBRDF(storage_forms.few_bands(count).reduce(file)).eval(pairs.wi, pairs.wo)
        assert kept.shape[1] == count
        back = kept @ storage_forms.interpolation(file.bands, count).T
        errors.append(np.linalg.norm(back - f) / np.linalg.norm(f))
    assert errors[0] > errors[1] > errors[2]
    assert errors[2] < 0.05  # linear between twelve nodes, constant beyond them


def _row(key, error, cost, spread=0.0, *, held_out=True):
    time = RelativeTime(cost, spread)
    return ChartRow(
        key=key, title=key, family="PCA", is_held_out=held_out,
        errors=Errors(**{name: np.array([error]) for name in ERRORS}),
        fit=time, predict=time, bytes=round(100 * cost),
    )  # fmt: skip


def test_times_within_their_spread_and_errors_within_a_percent_do_not_count_as_different():
    steady = [_row("a", 1.0, 10.0), _row("b", 1.0, 12.0), _row("c", 1.005, 10.05), _row("d", 1.5, 13.0)]
    assert fronts(steady)["rmse"]["predict"] == ["a", "c"]
    noisy = [_row("a", 1.0, 10.0, 2.2), _row("b", 1.0, 12.0, 2.2), _row("d", 1.5, 13.0, 2.2)]
    assert fronts(noisy)["rmse"] == {"predict": ["a", "b"], "bytes": ["a"], "fit": ["a", "b"]}


def test_errors_of_zero_and_costs_that_hardly_differ_can_be_read():
    found = (_row("copies", 0.0, 340.0), _row("dearer", 0.5, 340.2))
    figure = chart_figure.chart(Chart(found, fronts(found), 8, 3, 8, 1.0, {}))
    for axes in figure.axes:
        low, high = axes.get_xlim()
        assert high > 2.0 * low  # a power of ten and its multiples have room beside each other
        heights = [line.get_ydata()[0] for line in axes.lines if line.get_gid() is not None]
        assert sorted(heights) == [1e-4, 0.5]


def test_a_chart_says_which_setting_to_choose():
    def said(*found):
        return conclusion(Chart(found, fronts(found), 8, 3, 8, 1.0, {}))

    slow, fast, rough = _row("slow", 1.0, 100.0), _row("fast", 1.2, 20.0), _row("rough", 2.0, 1.0)
    cheat = _row("cheat", 0.1, 1.0, held_out=False)
    assert "left-out materials: slow, 1.00" in said(slow, fast, rough, cheat)
    assert "choose fast: 1.20, and 5 times as fast" in said(slow, fast, rough, cheat)
    assert "No faster setting" in said(slow, rough)
    assert said(cheat) == ""


def test_what_fits_warn_of_is_kept_with_their_setting(monkeypatch):
    def warning_fit(data, training):
        warnings.warn("not sure", UserWarning, stacklevel=1)
        return fit_nearest(data, training)

    monkeypatch.setattr(methods, "fit_nearest", warning_fit)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        nearest, linear = make_chart(FILES, ["nearest", "linear"], grid=GRID).rows
    assert nearest.warnings == ("not sure",) * min(10, len(FILES))
    assert linear.warnings == ()


@pytest.mark.parametrize(("count", "found"), [(1, "1 material,"), (3, "3 materials,")])
def test_few_materials_are_one_clear_error(count, found):
    with pytest.raises(UsageError, match=f"found {found} expected at least 4"):
        make_chart(FILES[:count])


def test_an_unknown_setting_is_one_clear_error():
    with pytest.raises(UsageError, match="no setting is called 'blend'; did you mean blend_2, blend_3, "):
        make_chart(FILES, ["blend"])


def test_the_document_lists_every_key():
    text = (Path(__file__).parents[2] / "docs/explanation/accuracy.md").read_text()
    listed = re.findall(
        r"`([^`]+)`", text.partition("**Keys** for `--only`:")[2].partition(". Libraries in RGB")[0]
    )
    own = [setting.key for setting in chart_methods(195)]
    assert listed == [*own, *(f"fit_{method}" for method in seen_fits.METHODS)]


# -- the picture -------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def figure(made):
    return chart_figure.chart(made)


def test_the_picture_says_which_setting_to_choose(figure, made):
    assert conclusion(made) in " ".join(figure.get_suptitle().split())


def _texts(axes):
    return [text.get_text() for text in axes.texts]


def test_every_panel_shows_every_setting_and_names_the_published_setting_and_the_front(figure, made):
    for k, axes in enumerate(figure.axes):
        error, cost = ("ball", "cube_root", "linear")[k % 3], list(COSTS)[k // 3]
        drawn = {line.get_gid(): line for line in axes.lines if line.get_gid()}
        assert set(drawn) == {row.key for row in made.rows}
        names = _texts(axes)
        assert AFTER_PUBLISHED in names
        front = made.front(error, cost)
        assert any(front[0].title in name or "(+" in name for name in names)
        for row in front:  # on the front: filled, in the colour of the family; dominated: white inside
            assert to_rgb(drawn[row.key].get_markerfacecolor()) != (1.0, 1.0, 1.0)
        dominated = [r.key for r in made.rows if r not in front and r.key != PUBLISHED]
        assert all(drawn[key].get_markersize() < drawn[front[0].key].get_markersize() for key in dominated)


def _require_names_apart(axes, renderer):
    boxes = [text.get_window_extent(renderer) for text in axes.texts]
    frame = axes.get_window_extent(renderer)
    for k, box in enumerate(boxes):
        assert box.x0 > frame.x0 - 1 and box.x1 < frame.x1 + 1  # noqa: PT018
        for other in boxes[:k]:
            width = min(box.x1, other.x1) - max(box.x0, other.x0)
            height = min(box.y1, other.y1) - max(box.y0, other.y0)
            assert width <= 0 or height <= 0.25 * box.height


def test_no_two_names_of_a_panel_cover_each_other_and_none_is_cut(figure):
    for axes in figure.axes:
        _require_names_apart(axes, figure.canvas.get_renderer())


@pytest.mark.parametrize("seed", [*range(5), 451, 2539, 96042])  # names of one crowd in 6,000 still meet
def test_names_of_points_anywhere_do_not_cover_each_other(seed):
    points = np.random.default_rng(seed).uniform(0.05, 0.95, (12, 2)) ** 2  # crowded in a corner
    drawn = figures.new_figure(5.0, 4.0)
    axes = drawn.subplots()
    axes.set(xlim=(0, 1), ylim=(0, 1))
    figures.fix_layout(drawn)
    names = [
        axes.annotate(
            f"setting number {k}, 6",
            p,
            xytext=(0, 0),
            textcoords="offset pixels",
            ha="center",
            va="center",
            fontsize=8,
        )
        for k, p in enumerate(points)
    ]
    figures.place_names(drawn, axes, names, 5.0, axes.transData.transform(points), zorder=2)
    _require_names_apart(axes, drawn.canvas.get_renderer())


def test_families_differ_in_shape_and_in_lightness_or_hue_for_all_kinds_of_colour_vision(figure):
    styles = chart_figure.STYLES.values()
    assert len({style.marker for style in styles}) == len(styles)
    assert len({style.colour for style in styles}) == len(styles)


def test_the_command_writes_table_picture_and_json(tmp_path):
    library = small_library.small_library(tmp_path)
    picture, document = tmp_path / "chart.png", tmp_path / "chart.json"
    only = [part for key in ("nearest", "pca_6_cube-root", PUBLISHED) for part in ("--only", key)]
    result = CliRunner().invoke(
        app, ["chart", "--library", str(library), *only, "-o", str(picture), "--json", str(document)]
    )
    assert result.exit_code == 0, result.output
    assert "PCA 6, cube-root" in result.output
    assert picture.read_bytes().startswith(b"\x89PNG")
    assert [row["key"] for row in json.loads(document.read_text())["rows"]] == [
        "nearest", PUBLISHED, "pca_6_cube-root",
    ]  # fmt: skip


def test_the_spread_of_several_works_is_that_of_their_runs_not_that_between_them():
    steady = [np.full(5, 1.0), np.full(5, 10.0), np.full(5, 3.0)]
    assert RelativeTime.of_several(steady) == RelativeTime(3.0, 0.0)
    noisy = [np.array([0.8, 0.9, 1.0, 1.1, 1.2]) * scale for scale in (1.0, 3.0, 10.0)]
    found = RelativeTime.of_several(noisy)
    assert found.median == pytest.approx(3.0)
    assert found.spread == pytest.approx(0.6)
