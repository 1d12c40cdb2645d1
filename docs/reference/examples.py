"""An example of every name of the Python interface, page by page, in the order in which they run.

`docs/reference_pages.py` prints each part under its name, and what stands below `# === PACKAGE` at the top of its page.
Pages share a folder, in which `manifold corpus corpus --rgb` has written the files of `corpus`, and `sample.xlsx` is a
workbook of a multi-angle spectrophotometer with pictures.
"""

# ruff: noqa: E402, I001, B015, B018

# === manifold

import manifold as mf

# manifold.import_files
imported = mf.import_files("corpus.zarr", ["corpus"])
imported.imported  # names

# manifold.Library
library = mf.Library("corpus.zarr")
library.names, library.bands
file = library.read("syn_satin_gold")

# manifold.BlendSettings
settings = mf.BlendSettings(latent_dim=2)

# manifold.GplvmSettings
published = mf.GplvmSettings.published()

# manifold.Manifold
model = mf.Manifold.fit(library, settings)
model.save("corpus.h5")
model = mf.Manifold.load("corpus.h5")
prediction = model.predict([-0.3, 1.2])

# manifold.built_in
built_in = mf.built_in()  # a Manifold of 20 measured RGB materials
built_in.library.names
built_in.predict([0.3, 0.2])

# manifold.read_bsdf
file = mf.read_bsdf("corpus/syn_satin_gold_rgb.bsdf")
file.name, file.bands, file.theta_i_rad

# manifold.MeasuredBRDF
brdf = mf.MeasuredBRDF(file)
wi = mf.directions.from_spherical(0.5, 0.0)
wo = mf.directions.from_spherical(0.7, 3.0)
brdf.eval(wi, wo)  # f in 1/sr, shape (3,)
brdf.albedo(wi)

# manifold.write_bsdf
mf.write_bsdf("copy_rgb.bsdf", file)

# manifold.Bands
rgb = mf.Bands(None)
bands = mf.Bands(range(400, 701, 10))
bands.count

# manifold.read_readings
readings = mf.read_readings("sample.xlsx")
readings.wi, readings.wo, readings.values  # (P, 3), (P, 3), (P, B)

# manifold.complete_readings
completion = mf.complete_readings(readings)  # with the built-in library
completion.brdf.eval(wi, wo)  # f in 1/sr, in the bands of the readings
completion.expected.ball, completion.expected.cube_root

# manifold.fit_bsdf
fit = mf.fit_bsdf(brdf)
fit.values, fit.notes

# manifold.render_ball
picture = mf.render_ball(brdf, size=32, samples=4)  # linear sRGB, (32, 32, 3)

# === manifold.directions

import manifold as mf

# manifold.directions
wi = mf.directions.from_spherical(0.5, 0.0)
wo = mf.directions.from_spherical(0.7, 3.0)
half = mf.directions.half_vector(wi, wo)
theta_h, theta_d, phi_d, phi_h = mf.directions.to_rusinkiewicz(wi, wo)

# === manifold.mapping

import numpy as np
import manifold as mf

# manifold.mapping
mapping = mf.mapping.CubeRoot()
mapping.inverse(mapping.forward(np.array([0.1, 2.0])))

# === manifold.metrics

import numpy as np
import manifold as mf

# manifold.metrics
f, f_star = np.array([0.1, 2.0]), np.array([0.11, 1.9])
mf.metrics.cube_root_error(f, f_star)

# === manifold.errors

import manifold as mf

# manifold.errors
try:
    mf.read_bsdf("missing.bsdf")
except mf.errors.ManifoldError as error:
    print(error)

# === manifold.gplvm

import numpy as np
import manifold as mf

# manifold.gplvm
Y = np.random.default_rng(0).normal(size=(8, 20))
latents = mf.gplvm.GPLVM(n_components=2).fit_transform(Y)  # (8, 2)

# === manifold.gpr

import numpy as np
import manifold as mf
from manifold.gp.kernels import SquaredExponential

# manifold.gpr
X = np.linspace(0.0, 3.0, 7)[:, None]
gp = mf.gpr.GaussianProcess(X, SquaredExponential(1e-4, 1.0))
gp.weights(np.array([[1.3]])) @ np.sin(X)

# === manifold.dls

import scipy.optimize
import manifold as mf

# manifold.dls
scipy.optimize.minimize(lambda x: (x**2).sum(), [1.0, 2.0], method=mf.dls.hooke_jeeves).x

# === manifold.brdf

import manifold as mf

brdf = mf.MeasuredBRDF(mf.read_bsdf("corpus/syn_satin_gold_rgb.bsdf"))

# manifold.brdf.goniometer
from manifold.brdf import goniometer

file = goniometer.measure(brdf, "gold_again")
mf.write_bsdf("gold_again_rgb.bsdf", file)

# manifold.brdf.BRDF
from manifold.brdf import BRDF

isinstance(brdf, BRDF)  # a class of your own needs bands, is_isotropic, eval and eval_cos

# manifold.brdf.to_xarray
from manifold.brdf import to_xarray

profile = to_xarray(brdf, theta_i_deg=45.0, theta_o_deg=range(0, 81, 10))
profile.sel(theta_i=45.0, phi=180.0)  # f in 1/sr by theta_o and band

# === manifold.analytic

import numpy as np
import manifold as mf

rgb = mf.Bands(None)
wi = mf.directions.from_spherical(0.5, 0.0)
wo = mf.directions.from_spherical(0.7, 3.0)

# manifold.analytic
grey = mf.analytic.Lambert(np.array(0.2), rgb)
grey.eval(wi, wo)  # 0.2 / pi

# manifold.analytic.GGX
brushed = mf.analytic.GGX.anisotropic(0.08, 0.3)

# manifold.analytic.Lambert
white_paper = mf.analytic.Lambert(np.array(0.9), rgb)

# manifold.analytic.Plastic
paint = mf.analytic.Plastic(mf.analytic.GGX.isotropic(0.1), np.array(1.5), np.array([0.6, 0.1, 0.1]), rgb)
paint.eval(wi, wo)

# manifold.analytic.RoughConductor
bands = mf.Bands(range(400, 701, 10))
eta, k = mf.colour.metal_ior("Au", np.array(bands.wavelengths_nm))
gold = mf.analytic.RoughConductor(brushed, eta, k, bands)
gold.is_isotropic  # False

# manifold.analytic.corpus
materials = mf.analytic.corpus.isotropic_materials()  # 51
materials[0].name, materials[0].recipe

# === manifold.colour

from pathlib import Path
import numpy as np
import manifold as mf

bands = mf.Bands(range(400, 701, 10))

# manifold.colour
mf.colour.illuminant_names()[:3]

# manifold.colour.illuminant_names
"D65" in mf.colour.illuminant_names()

# manifold.colour.to_srgb
mf.colour.to_srgb(np.ones(31), bands, "A")  # a perfect diffuser is (1, 1, 1) in every light

# manifold.colour.delta_e_2000
white = np.array([0.9505, 1.0, 1.0891])
mf.colour.delta_e_2000(0.20 * white, 0.21 * white, white)

# manifold.colour.metal_ior
eta, k = mf.colour.metal_ior("Au", np.array(bands.wavelengths_nm))

# manifold.colour.srgb_reflectance
red = mf.colour.srgb_reflectance([0.7, 0.1, 0.1], bands)  # shape (31,)

# manifold.colour.read_reflectance
lines = [f"{nm} {r:.4f}" for nm, r in zip(bands.wavelengths_nm, red, strict=True)]
Path("red.txt").write_text("\n".join(lines))
mf.colour.read_reflectance(Path("red.txt"), bands)

# === manifold.formats

import manifold as mf

brdf = mf.MeasuredBRDF(mf.read_bsdf("corpus/syn_satin_gold_rgb.bsdf"))

# manifold.formats.geometry_ma_t12
from manifold.formats import geometry_ma_t12

wi, wo = geometry_ma_t12()  # (12, 3) each

# manifold.formats.Readings
from manifold.formats import Readings

readings = Readings("sample", "by hand", wi, wo, None, brdf.eval(wi, wo))  # None: linear sRGB

# manifold.formats.read_all
from manifold.formats import read_all

samples = read_all("sample.xlsx")

# manifold.formats.read_readings
from manifold.formats import read_readings

sample = read_readings("sample.xlsx")
sample.wi.shape, sample.notes

# === manifold.convert

from pathlib import Path

# manifold.convert.convert
from manifold.convert import convert

convert([Path("corpus/syn_satin_gold_rgb.bsdf")], Path("gold.csv"))

# === manifold.model

import manifold as mf

model = mf.Manifold.load("corpus.h5")
brdf = mf.MeasuredBRDF(mf.read_bsdf("corpus/syn_satin_gold_rgb.bsdf"))

# manifold.model.ColourChoice
from manifold.model import ColourChoice

green = ColourChoice(like="syn_felt_green")

# manifold.model.OutputOptions
from manifold.model import OutputOptions

options = OutputOptions(physical=True)

# manifold.model.brdf_errors
from manifold.model import brdf_errors

errors = brdf_errors(brdf, model.reconstruct(brdf))
errors.ball, errors.cube_root, errors.linear

# manifold.model.rmse22
from manifold.model import rmse22

rmse22(brdf, model.predict([-0.3, 1.2]), "default")

# manifold.model.embed
from pathlib import Path
from manifold.model import embed

embed(Path("corpus.zarr"), Path("others.h5"), mf.BlendSettings(), without=["syn_satin_gold"])

# === manifold.estimate

from pathlib import Path
import manifold as mf
from manifold.formats import Readings, geometry_ma_t12
from manifold.model import ColourChoice

library = mf.Library("corpus.zarr")
model = mf.Manifold.load("corpus.h5")
brdf = mf.MeasuredBRDF(mf.read_bsdf("corpus/syn_satin_gold_rgb.bsdf"))
wi, wo = geometry_ma_t12()
readings = Readings("sample", "by hand", wi, wo, None, brdf.eval(wi, wo))

# manifold.estimate.predict
from manifold.estimate import predict

predicted = predict(model, [-0.3, 1.2], "between_rgb.bsdf", colour=ColourChoice(like="syn_felt_green"))
predicted.diagnostics

# manifold.estimate.locate
from manifold.estimate import locate

located = locate(model, "corpus/syn_satin_gold_rgb.bsdf")
located.latent, located.errors

# manifold.estimate.reconstruct
from manifold.estimate import reconstruct

left_out = ["syn_satin_gold"]
reconstruct(
    "corpus.zarr", "corpus/syn_satin_gold_rgb.bsdf", "again_rgb.bsdf", without=left_out, numbers=12
).errors

# manifold.estimate.LibraryAtoms
from manifold.estimate import LibraryAtoms

atoms = LibraryAtoms.of_library(library)

# manifold.estimate.Completion
from manifold.estimate import Completion

completion = Completion.of(atoms, readings)
completion.brdf.eval(wi, wo)

# manifold.estimate.calibrate
from manifold.estimate import calibrate

calibrate(atoms, readings, library).expected(completion)

# manifold.estimate.complete
from manifold.estimate import complete

completed = complete(Path("corpus.zarr"), readings, Path("sample_rgb.bsdf"))
completed.expected, completed.diagnostics

# manifold.estimate.suggest
from manifold.estimate import suggest

suggest(atoms, 3, completion).angles_deg

# === manifold.evaluate

import manifold as mf

model = mf.Manifold.load("corpus.h5")

# manifold.evaluate.make_report
from manifold.evaluate import make_report

report = make_report(model)
report.methods[0].title, report.methods[0].median.ball
report.to_pandas().groupby("method")["ball"].median()

# === manifold.fit

import manifold as mf

brdf = mf.MeasuredBRDF(mf.read_bsdf("corpus/syn_satin_gold_rgb.bsdf"))

# manifold.fit.FitResult
fit = mf.fit_bsdf(brdf)
fit.values["roughness"], fit.errors.ball
[str(statement) for statement in fit.statements]

# === manifold.fit.exports

# manifold.fit.exports.TARGETS
from manifold.fit.exports import TARGETS

list(TARGETS)

# === manifold.render

from pathlib import Path
import manifold as mf

brdf = mf.MeasuredBRDF(mf.read_bsdf("corpus/syn_satin_gold_rgb.bsdf"))

# manifold.render.FreeParameter
from manifold.render import FreeParameter

roughness = FreeParameter("alpha", 0.01, 1.0, 0.2)

# manifold.render.BsdfFamily
from manifold.render import BsdfFamily

metal = BsdfFamily("roughconductor", (roughness,), {"material": "Au"})

# manifold.render.render_material
from manifold.render import render_material
from manifold.render.render import RenderSettings

picture = render_material(brdf, RenderSettings(size=32, samples=4))

# manifold.render.write_image
from manifold.render import write_image

write_image(Path("gold.png"), picture)

# === manifold.pictures

from pathlib import Path
from manifold.estimate.sources import FileSource
from manifold.render.render import RenderSettings

gold = FileSource(Path("corpus/syn_satin_gold_rgb.bsdf"))
green = FileSource(Path("corpus/syn_felt_green_rgb.bsdf"))

# manifold.pictures.render
from manifold.pictures import render

rendered = render(gold, Path("gold.png"), RenderSettings(size=32, samples=4))

# manifold.pictures.compare
from manifold.pictures import compare

compare(gold, green, Path("pair.png"), RenderSettings(size=32, samples=4))

# === manifold.page

import manifold as mf

model = mf.Manifold.load("corpus.h5")

# manifold.page.MapWidget
from manifold.page import MapWidget

widget = MapWidget(model)  # shown by a notebook
widget.latent = [-0.3, 1.2]

# === manifold.surface

from pathlib import Path

# manifold.surface.read_workbook
from manifold.surface import read_workbook

pictures, readings = read_workbook(Path("sample.xlsx"))

# manifold.surface.estimate_surface
from manifold.surface import estimate_surface

surface = estimate_surface(pictures)

# manifold.surface.tile
from manifold.surface import tile

textures = tile(surface, size=512)

# manifold.surface.make_surface
from manifold.surface import make_surface

make_surface(Path("corpus.zarr"), pictures, readings, Path("sample_surface"), size=512)

# manifold.surface.read_surface
from manifold.surface import read_surface

written = read_surface("sample_surface")
written.name, written.textures.albedo.shape

# === manifold.study

import manifold as mf

library = mf.Library("corpus.zarr")

# manifold.study.make_chart
from manifold.study import make_chart

chart = make_chart([library.read(name) for name in library.names], only=["nearest", "linear"], fitted=1)
[(row.title, row.median.ball) for row in chart.rows]

# === manifold.shader

from pathlib import Path
import manifold as mf
from manifold.estimate.sources import FileSource

file = mf.read_bsdf("corpus/syn_satin_gold_rgb.bsdf")

# manifold.shader.make_shader
from manifold.shader import make_shader

shader = make_shader(file, tolerance=0.5)
shader.errors.ball

# manifold.shader.Shader
shader.name, shader.against, shader.notes

# manifold.shader.ShaderTable
shader.table.shape.bytes  # the texture, at most 1 MB

# manifold.shader.export
from manifold.shader import export

export(FileSource(Path("corpus/syn_satin_gold_rgb.bsdf")), Path("gold"))
