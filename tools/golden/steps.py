"""The steps: command lines, separated by semicolons, and calls from Python; the longest come first."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

from golden import calls

_PHOTO = "ball.tif --light light.exr"
_GREY = "shared/ball-photographs/gray/gray.0.png --light lamp.exr --exposure free"

COMMANDS: dict[str, str] = {
    # -- evaluations
    "report compared": "report -M corpus.h5 --compare",
    "budget": "budget --example felt --size 48 --samples 16 -o lean",
    "stability": "stability --only duplicates --only short_length_scale",
    "stability of fits": "stability --only brushed_fit --only out_of_gamut",
    "corpus": "corpus files --rgb",
    "report": "report -M real.h5 --picture",
    "report spectral": "report -M spectral.h5 --all-bands",
    "report anchored": "report -M corpus.h5 --principled",
    "chart": "chart -L real.zarr --only nearest --only published --only pca_4_cube-root --only blend_2"
    " --only nonnegative --only few_atoms --only blend_2_compact",
    "chart readings": "chart -L real.zarr --readings --only completion --only nearest",
    # -- pictures
    "map": "map -M real.h5 --mark 0.3,0.5 --srgb #a04020 -o map.png",
    "walk": "walk cardboard satin_purple --steps 4 -M real.h5 -o walk.png",
    "walk to a file": "walk real-left-out/paper_blue_rgb.bsdf 0.3,0.5 --steps 3 -M real.h5 -o walk.png",
    "walk spectral": "walk syn_satin_gold syn_felt_green --steps 3 -M spectral.h5 -o walk.png",
    "slices": "slices cardboard real-left-out/paper_blue_rgb.bsdf 0.3,0.5 -M real.h5 -o angles.png;"
    "slices cardboard --kind image -M real.h5 -o image.png;"
    "slices syn_satin_gold --kind spectra -M spectral.h5 -o spectra.png;"
    "slices syn_satin_gold --bands 450,650 -M spectral.h5 -o bands.png",
    "render": "render cardboard -M real.h5 --size 48 --samples 16 -o file.exr;"
    "render 0.3,0.5 --srgb #a04020 -M real.h5 --size 48 --samples 16 -o place.exr;"
    "render 0.3,0.5 --direct -M real.h5 --size 48 --samples 16 -o direct.exr",
    "render spectral": "render syn_metal_copper -M spectral.h5 --illuminant F11 --size 48 --samples 16 -o copper.exr;"
    "render spectral-left-out/syn_satin_rose_spec.bsdf --environment light.exr --size 48 --samples 16 -o rose.png",
    "render places": "render --from places.csv -M real.h5 --size 32 --samples 8 -o balls",
    "compare": "compare cardboard 0.3,0.5 -M real.h5 --size 48 --samples 16 -o materials.png",
    "page": "explore -o map.html -M real.h5",
    "page spectral": "explore -o map.html -M spectral.h5",
    # -- libraries
    "import": "import real -L own.zarr; info own.zarr --verify; import real-left-out -L own.zarr",
    "compact": "import real -L own.zarr; compact own.zarr --tolerance 0.3; embed -L own.zarr -M own.h5",
    "import compact": "import corpus -L own.zarr --compact; find --gloss 60=40 -L own.zarr",
    "import turned": "import corpus -L own.zarr --rotation auto; info own.zarr",
    "info": "info real-left-out/paper_blue_rgb.bsdf; info real.zarr; info real.h5; info cardboard -M real.h5;"
    "info -M real.h5 0.3,0.5; info syn_satin_gold -M spectral.h5",
    "info of simulators": "info shared/bsdf-tools/AnoBlackEC1onAlum.bsdf; info shared/bsdf-tools/AnoBlackEC1onAlum.txt;"
    "info shared/bsdf-tools/20250210_S7_sample_final.txt; info shared/ma-t12/PAR_PW_CN_MC_2.xlsx;"
    "info shared/openmaterial/example_material_camera_brdf.xompt",
    "find": "find --lab 50,20,10 --gloss 60=30 -L real.zarr; find --gloss 20=10 --gloss 85=60 --count 3 -L real.zarr;"
    "find --lab 50,20,10 -L spectral.zarr",
    # -- maps
    "embed": "embed -L real.zarr -M own.h5",
    "embed corpus in 3": "embed -L corpus.zarr -q 3 -M own.h5 --kernel matern52",
    "embed automatically": "embed -L corpus.zarr -q auto -M own.h5",
    "embed landmarks": "embed -L real.zarr --landmarks 5 -M own.h5 --without chm_mint",
    "embed spectral": "embed -L spectral.zarr -M own.h5",
    "embed materials": "embed -L real.zarr --kind gplvm --mapping log-relative -M own.h5;"
    "locate real-left-out/paper_blue_rgb.bsdf -M own.h5 -o located.bsdf; predict 0.1,0.2 -M own.h5 -o predicted.bsdf;"
    "report -M own.h5",
    "embed as published": "embed -L real.zarr --kind gplvm --mapping identity -M own.h5;"
    "predict cardboard -M own.h5 -o predicted.bsdf; predict 0.1,0.2 -M own.h5 -o between.bsdf",
    # -- predictions
    "predict place": "predict 0.3,0.5 -M real.h5 -o place.bsdf",
    "predict material": "predict cardboard -M real.h5 -o material.bsdf",
    "predict file": "predict real-left-out/paper_blue_rgb.bsdf -M real.h5 -o file.bsdf",
    "predict walk": "predict cardboard:satin_purple:0.4 -M real.h5 -o walk.bsdf",
    "predict colours": "predict 0.3,0.5 --like satin_purple -M real.h5 -o like.bsdf;"
    "predict 0.3,0.5 --srgb #a04020 -M real.h5 -o srgb.bsdf;"
    "predict 0.3,0.5 --reflectance reflectance.txt -M real.h5 -o reflectance.bsdf",
    "predict attributes": "predict cardboard --gloss 60=20 --hue 40 -M real.h5 -o gloss.bsdf;"
    "predict cardboard --lightness +10 --chroma -3 -M real.h5 -o lighter.bsdf",
    "predict physical": "predict 0.3,0.5 --physical -M real.h5 -o physical.bsdf",
    "predict grid": "predict 0.3,0.5 --resolution 16 --incidences 6 -M real.h5 -o grid.bsdf",
    "predict table": "predict --from places.csv -M real.h5 -o table -j 1",
    "predict spectral": "predict 0.3,0.2 -M spectral.h5 -o place.bsdf;"
    "predict 0.3,0.2 --srgb #a04020 -M spectral.h5 -o srgb.bsdf;"
    "predict 0.3,0.2 --reflectance reflectance.txt -M spectral.h5 -o reflectance.bsdf",
    # -- whole files on the map and in the library
    "locate": "locate real-left-out/paper_blue_rgb.bsdf -M real.h5 -o located.bsdf; locate 0.3,0.5 -M real.h5",
    "locate several": "locate real-left-out -M real.h5 -o located -j 1",
    "locate spectral": "locate spectral-left-out/syn_satin_rose_spec.bsdf -M spectral.h5 -o located.bsdf",
    "reconstruct": "reconstruct real-left-out/paper_blue_rgb.bsdf -L real.zarr -o made.bsdf;"
    "reconstruct cardboard --without cardboard -L real.zarr -M real.h5 -o cardboard.bsdf",
    "reconstruct in 12 numbers": "reconstruct real-left-out/paper_blue_rgb.bsdf --numbers 12 -L real.zarr -o made.bsdf;"
    "reconstruct real-left-out/cm_toxic_green_rgb.bsdf --numbers 24 -L real.zarr -o green.bsdf",
    "reconstruct several": "reconstruct corpus-left-out -L real.zarr -o made -j 1",
    "reconstruct spectral": "reconstruct spectral-left-out/syn_satin_rose_spec.bsdf -L spectral.zarr -o made.bsdf",
    "reconstruct physical": "reconstruct real-left-out/paper_blue_rgb.bsdf --physical -L real.zarr -o made.bsdf",
    # -- readings
    "complete twelve readings": "complete ma-t12/syn_satin_rose.xlsx -L real.zarr -o made.bsdf --suggest 3 --picture",
    "surface": "surface shared/ma-t12/PEN_PW_RO_CC_1.xlsx -L real.zarr -o own --size 192 --target gltf",
    "complete together": f"photograph {_PHOTO} --readings ma-t12/syn_satin_rose.xlsx --circle 24,24,18.46 --gloss 60=40"
    " -L corpus.zarr -o made.bsdf",
    "complete real paint": "complete shared/ma-t12/PAR_PW_CN_MC_2.xlsx -L real.zarr -o made.bsdf;"
    "complete shared/ma-t12/PEN_PW_RO_CC_1.xlsx --gloss 60=20 -L corpus.zarr -o gloss.bsdf",
    "complete goniometer": "complete mini-diff/syn_satin_rose.astm -L real.zarr -o made.bsdf",
    "complete both": "complete ma-t12/syn_satin_rose.xlsx mini-diff/syn_satin_rose.astm --merge -L corpus.zarr"
    " -o made.bsdf --gloss 20=15 --gloss 60=45",
    "complete one reading": "complete sand.csv -L real.zarr -o made.bsdf;"
    "complete sand.csv --gloss 60=30 -L real.zarr -o gloss.bsdf",
    "complete colour": "complete --lab 40,50,30 --gloss 60=70 -L real.zarr -o gloss.bsdf;"
    "complete --lab 40,50,30 -L real.zarr -o colour.bsdf; complete --lab 60,5,20 -L spectral.zarr -o spectral.bsdf",
    "complete other formats": "complete formats/cxf/smooth.cxf -L real.zarr -o cxf.bsdf;"
    "complete formats/lighttools/smooth.bsdf -L corpus.zarr -o lighttools.bsdf;"
    "complete formats/zemax/smooth.bsdf -L corpus.zarr -o zemax.bsdf",
    "complete spectral": "complete ma-t12/syn_satin_rose.xlsx -L spectral.zarr -o made.bsdf;"
    "complete mini-diff/syn_satin_rose.astm -L spectral.zarr -o goniometer.bsdf",
    "complete several": "complete ma-t12/syn_felt_yellow.xlsx ma-t12/syn_chrome_mint.xlsx ma-t12/syn_satin_rose.xlsx"
    " -L real.zarr -o made --into own.zarr -j 2; info own.zarr",
    "complete physical": "complete ma-t12/syn_satin_rose.xlsx -L real.zarr -o made.bsdf --physical --resolution 16",
    "complete photograph": f"photograph {_PHOTO} -L corpus.zarr -o made.bsdf --picture",
    "complete photograph and readings": f"photograph {_PHOTO} --readings ma-t12/syn_satin_rose.xlsx"
    " --circle 24,24,18.46 -L corpus.zarr -o made.bsdf",
    "complete photograph spectral": f"photograph {_PHOTO} -L spectral.zarr -o made.bsdf",
    "complete grey ball": f"photograph {_GREY} --circle 241,245,150 -L real.zarr -o made.bsdf",
    "suggest": "complete -L real.zarr --suggest 4; complete -L real.zarr --suggest 3 --instrument ma-t12;"
    "complete ma-t12/syn_satin_rose.xlsx -L real.zarr --suggest 3 --instrument mini-diff -o made.bsdf",
    "calibrate": "calibrate ma-t12-few mini-diff-few --allow-harm -o correction.json;"
    "complete mini-diff/syn_satin_rose.astm --correction correction.json -L real.zarr -o made.bsdf;"
    "convert mini-diff/syn_satin_rose.astm --correction correction.json -o rose.csv",
    # -- fits and exports
    "fit": "fit cardboard -M real.h5 -o cardboard.json --picture",
    "fit chrome film": "fit chm_mint -M real.h5 -o chrome.json --metric cube-root;"
    "fit chm_mint -M real.h5 -o linear.json --metric linear",
    "fit by swarm": "fit cardboard -M real.h5 -o swarm.json --method swarm",
    "fit by Adam": "fit cardboard -M real.h5 -o adam.json --method adam",
    "fit few": "fit cardboard -M real.h5 -o few.json --free base_color,roughness;"
    "fit cardboard -M real.h5 -o own.json --bsdf diffuse.json",
    "fit place and readings": "fit 0.3,0.5 -M real.h5 -o place.json; fit ma-t12/syn_satin_rose.xlsx"
    " -o readings.json; fit syn_satin_gold -M spectral.h5 -o spectral.json",
    "fit several": "fit real-left-out -o fits -j 1",
    "export fit": "fit cardboard -M real.h5 -o cardboard.json; export cardboard.json -o fitted.glb;"
    "export cardboard.json --against real/cardboard_rgb.bsdf -o direct.mtlx;"
    "render cardboard.json --size 32 --samples 8 -o fit.exr",
    "export library": "export real-left-out --target unreal -o exports",
    "export place": "export 0.3,0.5 --srgb #a04020 -M real.h5 -o place.usda",
    # -- conversions
    "convert place and spectra": "convert 0.3,0.5 -M real.h5 -o place.binary;"
    "convert spectral-left-out/syn_satin_rose_spec.bsdf -o spectra.csv;"
    "convert spectral-left-out/syn_satin_rose_spec.bsdf -o spectra.xompt;"
    "convert real-left-out/paper_blue_rgb.bsdf --resolution 16 --incidences 6 -o small.bsdf",
    "convert several": "convert real-left-out corpus-left-out --format merl -o merl -j 1",
    "convert simulators": "convert shared/bsdf-tools/AnoBlackEC1onAlum.bsdf -o zemax.csv;"
    "convert shared/bsdf-tools/AnoBlackEC1onAlum_fullAz.txt -o fred.bsdf;"
    "convert shared/openmaterial/example_material_camera_brdf.xompt -o asphalt.csv",
}  # fmt: skip

_FORMATS = {
    "merl": ".binary", "utia": ".bin", "lighttools": ".bsdf", "zemax": ".bsdf", "fred": ".txt", "speos": ".brdf",
    "speos-anisotropic": ".anisotropicbsdf", "openmaterial": ".xompt", "astm": ".astm", "csv": ".csv",
}  # fmt: skip
_READ = {
    "ma-t12": ".xlsx", "csv": ".csv", "cxf": ".cxf", "astm": ".astm", "mini-diff": ".astm", "pab-opto": ".txt",
    "lighttools": ".bsdf", "zemax": ".bsdf", "fred": ".txt", "speos": ".brdf",
    "speos-anisotropic": ".anisotropicbsdf", "openmaterial": ".xompt", "rt-300s": ".xls", "merl": ".binary",
    "utia": ".bin",
}  # fmt: skip
_TARGETS = {
    "gltf": "glb", "openpbr": "mtlx", "standard-surface": "mtlx", "usd": "usda", "usd-materialx": "usda",
    "blender": "py", "blender-json": "json", "unreal": "json", "unity": "json",
}  # fmt: skip
_ONE_WAY = ("fred", "speos-anisotropic", "speos", "openmaterial")  # one band, or much to read again
_FEW_READINGS = ("ma-t12", "csv", "cxf", "astm", "pab-opto")
_SPECTRAL = ("speos", "openmaterial")
_RGB_FILE = "real-left-out/paper_blue_rgb.bsdf"
_SPECTRAL_FILE = "spectral-left-out/syn_satin_rose_spec.bsdf"
COMMANDS |= {
    f"convert to {name}": f"convert {_SPECTRAL_FILE if name in _SPECTRAL else _RGB_FILE}"
    f" --format {name} -o made{suffix}; info made{suffix}"
    + f";convert made{suffix} -o back.bsdf"
    * (name not in _ONE_WAY)
    for name, suffix in _FORMATS.items()
}
COMMANDS |= {
    f"convert from {name}": f"info formats/{name}/smooth{suffix}; convert formats/{name}/smooth{suffix} -o table.csv"
    + f";convert formats/{name}/smooth{suffix} -o made.bsdf" * (name not in _FEW_READINGS)
    for name, suffix in _READ.items()
}
COMMANDS |= {
    f"export to {name}": f"export real-left-out/cm_toxic_green_rgb.bsdf --target {name} -o made.{suffix}"
    for name, suffix in _TARGETS.items()
}

CALLS: dict[str, Callable[[Path], dict[str, Any]]] = {
    call.__name__.replace("_", " "): call for call in calls.ALL
}
"""Python calls by the names of their steps: of the folder of the inputs; what they return is kept."""
