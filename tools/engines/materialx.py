"""Balls and planes in MaterialX's own renderer of GLSL, for a Python interpreter that has `MaterialX`, and an X server.

    python materialx.py TASK

TASK is JSON. Pictures are linear, RGB, rows from above. World: y up, radii of the ball; a white diffuser that faces a
sun has the radiance 1. Environments are arrays (H, 2 H) of grey radiance in MaterialX's layout, see `balls.layout`,
each with the irradiance over pi of surfaces that face the directions of a smaller one.
"""

import json
import math
import sys
import tempfile
from pathlib import Path

import MaterialX as mx
import numpy as np
from MaterialX import PyMaterialXGenGlsl as gen_glsl
from MaterialX import PyMaterialXGenShader as gen
from MaterialX import PyMaterialXRender as render
from MaterialX import PyMaterialXRenderGlsl as render_glsl

task = json.loads(sys.argv[1])
COLUMNS, ROWS = 256, 128  # of the ball's mesh


def ball(folder):
    """A Wavefront file of a unit sphere."""
    theta = np.linspace(0.0, np.pi, ROWS + 1)[:, None]
    phi = np.linspace(0.0, 2.0 * np.pi, COLUMNS + 1)[None]
    points = np.stack(
        np.broadcast_arrays(np.sin(theta) * np.sin(phi), np.cos(theta), np.sin(theta) * np.cos(phi)), -1
    )
    lines = [f"{kind} {x:.7f} {y:.7f} {z:.7f}" for kind in ("v", "vn") for x, y, z in points.reshape(-1, 3)]
    places = np.stack(np.broadcast_arrays(phi / (2.0 * np.pi), 1.0 - theta / np.pi), -1)
    lines += [f"vt {u:.7f} {v:.7f}" for u, v in places.reshape(-1, 2)]
    for row in range(ROWS):
        for column in range(COLUMNS):
            a = row * (COLUMNS + 1) + column + 1
            b, c, d = a + COLUMNS + 1, a + COLUMNS + 2, a + 1
            for corners in ((a, b, d),) * (row > 0) + ((d, b, c),) * (row < ROWS - 1):
                lines.append("f " + " ".join(f"{k}/{k}/{k}" for k in corners))
    path = folder / "ball.obj"
    path.write_text("\n".join(lines) + "\n")
    return path


def plane(folder):
    """A Wavefront file of a square of side 2 that faces up, with rows of textures along z."""
    corners = [(-1, 1), (1, 1), (1, -1), (-1, -1)]
    lines = [f"v {x} 0 {z}\nvt {(1 + x) / 2} {(1 - z) / 2}" for x, z in corners]
    path = folder / "plane.obj"
    path.write_text("\n".join([*lines, "vn 0 1 0", "f 1/1/1 2/2/1 3/3/1", "f 1/1/1 3/3/1 4/4/1"]) + "\n")
    return path


def image_of(values):
    """An image of grey values (H, W)."""
    made = render.Image.create(values.shape[1], values.shape[0], 3, render.BaseType.FLOAT)
    made.createResourceBuffer()
    for y, row in enumerate(values):
        for x, value in enumerate(row):
            made.setTexelColor(x, y, mx.Color4(float(value), float(value), float(value), 1.0))
    return made


def light_of(described):
    """Direction of the lamp, all 0 for none, radiance of the surroundings, and irradiance over pi."""
    if "towards" in described:
        return described["towards"], *[image_of(np.zeros((2, 4)))] * 2
    return [0.0, 0.0, 0.0], *(image_of(np.load(path)) for path in described)


def pixels_of(image, size):
    """Values (size, size, 3) of a picture, in the order of its rows."""
    texels = (image.getTexelColor(x, y) for y in range(size) for x in range(size))
    return np.array([[texel[k] for k in range(3)] for texel in texels]).reshape(size, size, 3)


def document_of(path, library):
    """The document of a file, or of a UsdPreviewSurface whose inputs are in JSON: type and value by name."""
    document = mx.createDocument()
    if path.endswith(".mtlx"):
        mx.readFromXmlFile(document, path)
    else:
        shader = document.addNode("UsdPreviewSurface", "shader", "surfaceshader")
        for name, (kind, value) in json.loads(Path(path).read_text()).items():
            shader.addInput(name, kind).setValueString(value)
        material = document.addNode("surfacematerial", "material", "material")
        material.addInput("surfaceshader", "surfaceshader").setNodeName("shader")
    document.setDataLibrary(library)
    return document


def main():
    """Draw every material in every light."""
    size, is_plane = task["size"] * task["finer"], task["shape"] == "plane"
    library = mx.createDocument()
    search = mx.getDefaultDataSearchPath()
    mx.loadLibraries(mx.getDefaultDataLibraryFolders(), search, library)
    renderer = render_glsl.GlslRenderer.create(size, size, render.BaseType.FLOAT)
    renderer.initialize()
    renderer.setImageHandler(render_glsl.GLTextureHandler.create(render.StbImageLoader.create()))
    with tempfile.TemporaryDirectory() as folder:
        geometry = render.GeometryHandler.create()
        geometry.addLoader(render.TinyObjLoader.create())
        shape = (plane if is_plane else ball)(Path(folder))
        geometry.loadGeometry(mx.FilePath(str(shape)), False)
        renderer.setGeometryHandler(geometry)
    view, edge, far = mx.Vector3(*task["view"]), task["edge"], 1e3
    camera = render.Camera.create()
    up = mx.Vector3(0, 0, -1) if is_plane else mx.Vector3(0, 1, 0)
    camera.setViewMatrix(render.Camera.createViewMatrix(view * far, mx.Vector3(0, 0, 0), up))
    camera.setProjectionMatrix(
        render.Camera.createOrthographicMatrix(-edge, edge, -edge, edge, far - 2, far + 2)
    )
    renderer.setCamera(camera)
    lights = {key: light_of(described) for key, described in task["lights"].items()}
    lamps = mx.createDocument()
    lamps.setDataLibrary(library)
    lamp = lamps.addNode("directional_light", "lamp", "lightshader")
    lamp.setInputValue("color", mx.Color3(1.0, 1.0, 1.0))
    handler = render.LightHandler.create()
    handler.setLightSources([lamp])
    renderer.setLightHandler(handler)
    for name, path in task["materials"].items():
        document = document_of(path, library)
        renderer.getImageHandler().setSearchPath(mx.FileSearchPath(str(Path(path).parent)))
        generator = gen_glsl.GlslShaderGenerator.create()
        colours = gen.DefaultColorManagementSystem.create(generator.getTarget())
        colours.loadLibrary(library)
        generator.setColorManagementSystem(colours)
        context = gen.GenContext(generator)
        context.registerSourceCodeSearchPath(search)
        handler.registerLights(lamps, [lamp], context)
        options = context.getOptions()
        options.targetColorSpaceOverride = "lin_rec709"
        options.fileTextureVerticalFlip = True  # as its viewer has it
        options.hwSpecularEnvironmentMethod = gen.HwSpecularEnvironmentMethod.SPECULAR_ENVIRONMENT_FIS
        (element,) = gen.findRenderableElements(document)
        renderer.createProgram(generator.generate("material", element, context))
        for key, (towards, radiance, irradiance) in lights.items():
            is_lit = any(towards)
            lamp.setInputValue("direction", mx.Vector3(*(-x for x in (towards if is_lit else task["view"]))))
            lamp.setInputValue("intensity", math.pi if is_lit else 0.0)
            handler.setEnvRadianceMap(radiance)
            handler.setEnvIrradianceMap(irradiance)
            handler.setEnvSampleCount(1 if is_lit else task["samples"])
            renderer.render()
            picture = pixels_of(renderer.captureImage(None), size)
            cells = picture.reshape(task["size"], task["finer"], task["size"], task["finer"], 3)
            np.save(
                f"{task['folder']}/{name} {key}.npy", np.nanmean(cells, axis=(1, 3))
            )  # where it divides by 0, at the pole
    print(json.dumps(mx.getVersionString()))


main()
