// The ground that a shape stands on, and its shadow: a white floor's radiance, in the frame of an environment. No page is touched here.

export const GROUND_REACH = 4; // radii of the ball, from the middle to the edge of a picture of the ground
const GROUND_TEXELS = 64; // texels along it
const GROUND_CELLS = { elevations: 12, azimuths: 48 }; // of the light from above
const PENUMBRA = Math.PI / 48; // half the width of a shadow's edge, radians: half a cell
export const SHAPES_ON_GROUND = { // height of the middle, and radius of a ball whose shadow stands for the shape's
  ball: { height: 1, radius: 1 }, cloth: { height: 0.78, radius: 0.8 }, box: { height: 0.54, radius: 0.62 },
};

/** Light of cells above the horizon: directions towards them, and radiance times cosine and solid angle over pi. */
function lightsFrom({ rows, columns, radiance }) {
  const { elevations, azimuths } = GROUND_CELLS, cells = new Map();
  for (let row = 0; row < rows / 2; row++) {
    const theta = (Math.PI * (row + 0.5)) / rows;
    const weight = (Math.cos(theta) * Math.sin(theta) * (Math.PI / rows) * ((2 * Math.PI) / columns)) / Math.PI;
    for (let column = 0; column < columns; column++) {
      const key = Math.floor((row * elevations) / (rows / 2)) * azimuths + Math.floor((column * azimuths) / columns);
      const phi = (2 * Math.PI * (column + 0.5)) / columns, at = 3 * (row * columns + column);
      const cell = cells.get(key) ?? cells.set(key, { w: [0, 0, 0], light: [0, 0, 0] }).get(key);
      const power = weight * (radiance[at] + radiance[at + 1] + radiance[at + 2]);
      const w = [Math.sin(theta) * Math.sin(phi), Math.sin(theta) * Math.cos(phi), Math.cos(theta)];
      w.forEach((v, c) => (cell.w[c] += power * v));
      for (let c = 0; c < 3; c++) cell.light[c] += weight * radiance[at + c];
    }
  }
  return [...cells.values()].map(({ w, light }) => ({ w: w.map((v) => v / Math.hypot(...w)), light }));
}

/** The ground with the shadow of a shape, of a white floor: texels (RGBA), side x side, over GROUND_REACH each way. */
export function groundPicture(environment, { height, radius }) {
  const lights = lightsFrom(environment), values = new Float32Array(4 * GROUND_TEXELS * GROUND_TEXELS);
  for (let k = 0; k < GROUND_TEXELS * GROUND_TEXELS; k++) {
    const [x, y] = [k % GROUND_TEXELS, Math.floor(k / GROUND_TEXELS)].map((v) => (((v + 0.5) / GROUND_TEXELS) * 2 - 1) * GROUND_REACH);
    const away = Math.hypot(x, y, height), sine = Math.min(radius / away, 1), cosine = Math.sqrt(1 - sine * sine);
    const far = Math.min(Math.max((3 * Math.hypot(x, y)) / GROUND_REACH - 2, 0), 1); // no shadow at the picture's edge
    for (const { w, light } of lights) {
      const along = (-x * w[0] - y * w[1] + height * w[2]) / away; // cosine between the light and the middle of the shape
      const seen = Math.min(Math.max(0.5 + (cosine - along) / (2 * PENUMBRA * sine), 0), 1);
      for (let c = 0; c < 3; c++) values[4 * k + c] += Math.max(seen, far) * light[c];
    }
    values[4 * k + 3] = 1;
  }
  return { side: GROUND_TEXELS, values };
}

/** Radiance of an environment's floor, which is its reflectance: an unshadowed white floor has the radiance 1. */
export const floorOf = ({ rows, columns, radiance }) => [0, 1, 2].map((c) => radiance[3 * (rows - 1) * columns + c]);
