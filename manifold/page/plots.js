// Curves as SVG: slices over angles, and reflectances.

import { interp } from "./numerics.js";

const SVG = "http://www.w3.org/2000/svg";
const CHANNELS = ["red", "green", "blue"];
const HEIGHT = 200, LEFT = 44, RIGHT = 10, TOP = 10, BOTTOM = 34;

function element(name, attributes, text) {
  const made = document.createElementNS(SVG, name);
  for (const [key, value] of Object.entries(attributes)) made.setAttribute(key, value);
  if (text !== undefined) made.textContent = text;
  return made;
}

const widthOf = (svg) => Math.max(svg.clientWidth || 420, 240);

const short = (v) => (v === 0 ? "0" : v >= 100 ? v.toFixed(0) : v >= 1 ? String(Number(v.toFixed(1))) : v.toPrecision(1));

/** Draws lines {x, y, class} into an svg element; y is shown through `scale`, whose ticks are values. */
function draw(svg, lines, label, { xRange, xTicks, xLabel, yMax, yTicks, yLabel, scale }) {
  const WIDTH = widthOf(svg);
  const px = (x) => LEFT + ((x - xRange[0]) / (xRange[1] - xRange[0])) * (WIDTH - LEFT - RIGHT);
  const py = (y) => HEIGHT - BOTTOM - (scale(y) / scale(yMax)) * (HEIGHT - TOP - BOTTOM);
  const parts = [];
  for (const tick of yTicks) {
    parts.push(element("line", { x1: LEFT, x2: WIDTH - RIGHT, y1: py(tick), y2: py(tick), class: "rule" }));
    parts.push(element("text", { x: LEFT - 5, y: py(tick) + 4, "text-anchor": "end" }, short(tick)));
  }
  for (const tick of xTicks) {
    parts.push(element("line", { x1: px(tick), x2: px(tick), y1: TOP, y2: HEIGHT - BOTTOM, class: "rule" }));
    parts.push(element("text", { x: px(tick), y: HEIGHT - BOTTOM + 14, "text-anchor": "middle" }, String(tick)));
  }
  const middle = (LEFT + WIDTH - RIGHT) / 2, centre = (TOP + HEIGHT - BOTTOM) / 2;
  parts.push(element("text", { x: middle, y: HEIGHT - 4, "text-anchor": "middle" }, xLabel));
  const turned = { x: 12, y: centre, "text-anchor": "middle", transform: `rotate(-90 12 ${centre})` };
  parts.push(element("text", turned, yLabel));
  for (const line of lines) {
    const points = line.x.map((x, k) => `${px(x).toFixed(1)},${py(Math.max(line.y[k], 0)).toFixed(1)}`).join(" ");
    parts.push(element("polyline", { points, class: line.class }));
  }
  svg.setAttribute("aria-label", label);
  svg.setAttribute("viewBox", `0 0 ${WIDTH} ${HEIGHT}`);
  svg.replaceChildren(...parts);
}

/** The highest values of slices as text. */
const peaks = (slices) => slices.map(({ incidence, angles, f }) => {
  const most = Math.max(...f);
  return `incidence ${incidence}° at most ${most.toPrecision(2)} at ${angles[f.indexOf(most)].toFixed(0)}°`;
}).join(", ");

/** Reflectances as text: of three channels, or at a few wavelengths. */
const reflectances = (wavelengths, values) => (wavelengths
  ? [450, 550, 650].map((nm) => `${interp(nm, wavelengths, values).toFixed(2)} at ${nm} nm`)
  : CHANNELS.map((name, c) => `${name} ${values[c].toFixed(2)}`)).join(", ");

const withOther = (text, other, name) => (other ? `${text}; ${name}: ${other}` : text);

/** In-plane slices on a cube-root axis; the other prediction's are dashed. */
export function drawSlices(svg, slices, other, otherName) {
  const all = [...slices, ...(other ?? [])];
  const most = Math.max(0.05, ...all.flatMap((slice) => slice.f));
  const yTicks = [0.001, 0.01, 0.1, 1, 10, 100, 1000, 10000].filter((v) => v < most && v > most / 2000);
  const line = (dash) => ({ angles, f }, k) => ({ x: angles, y: f, class: `line slice-${k}${dash}` });
  const label = withOther(`BRDF in the plane of incidence: ${peaks(slices)}`, other && peaks(other), otherName);
  draw(svg, [...(other ?? []).map(line(" other")), ...slices.map(line(""))], label, {
    xRange: [-85, 85], xTicks: [-60, -40, -20, 0, 20, 40, 60], xLabel: "outgoing angle in degrees, mirror side positive",
    yMax: most, yTicks: [0, ...yTicks], yLabel: "f in 1/sr", scale: Math.cbrt,
  });
}

/** Reflectance over wavelength, or of three channels as bars. */
export function drawReflectance(svg, wavelengths, values, other, otherName) {
  const label = withOther(`Reflectance: ${reflectances(wavelengths, values)}`,
    other && reflectances(wavelengths, other), otherName);
  const yMax = Math.max(1, ...values, ...(other ?? []));
  const common = { yMax, yTicks: [0, 0.2, 0.4, 0.6, 0.8, 1], yLabel: "reflectance", scale: (v) => v };
  if (wavelengths) {
    const lines = [{ x: wavelengths, y: values, class: "line spectrum" }];
    if (other) lines.unshift({ x: wavelengths, y: other, class: "line spectrum other" });
    const xRange = [wavelengths[0], wavelengths[wavelengths.length - 1]];
    const xTicks = [400, 450, 500, 550, 600, 650, 700, 750].filter((v) => v >= xRange[0] && v <= xRange[1]);
    draw(svg, lines, label, { ...common, xRange, xTicks, xLabel: "wavelength in nm" });
    return;
  }
  draw(svg, [], label, { ...common, xRange: [0, 3], xTicks: [], xLabel: "linear sRGB" });
  const base = HEIGHT - BOTTOM, full = HEIGHT - TOP - BOTTOM, slot = (widthOf(svg) - LEFT - RIGHT) / 3;
  CHANNELS.forEach((name, c) => {
    const bar = (v, x, width, kind) => {
      const height = (Math.max(v, 0) / yMax) * full;
      svg.append(element("rect", { x, y: base - height, width, height, class: `bar ${name}${kind}` }));
    };
    const x = LEFT + slot * (c + 0.2);
    bar(values[c], x, slot * (other ? 0.34 : 0.6), "");
    if (other) bar(other[c], x + slot * 0.36, slot * 0.24, " other");
    svg.append(element("text", { x: x + slot * 0.3, y: base + 14, "text-anchor": "middle" },
      `${name} ${values[c].toFixed(3)}`));
  });
}
