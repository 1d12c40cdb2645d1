// Predictions as the package makes them: (sum_i v_i f_i^(1/3))^3 in every band. Formulas are named as in Python. No page is
// touched here.

import { luminance, tinted } from "./colour.js";

const NEGLIGIBLE = 3e-4, NEIGHBOURS = 128; // as in manifold/model/blending.py
const TABLE = 65, NEWTON_STEPS = 2, LARGEST_STEP = 0.02, PROBE = 1e-3; // as in manifold/model/colour_paths.py
const LEAST_COMPONENT = 2e-5; // of a chosen colour: a weight that no picture shows
const SHAPE_KEPT = 4, MOST_EXCESS = 3; // as in manifold/model/walks.py
const PATH_NODES = 8; // coordinates at which a spectral blend's colour path is followed: 0.1 CIEDE2000 beside all 32

/** Weights of materials X (N, Q) at a place x (Q): never negative, of sum 1, a unit vector at a material. */
export function blendWeights(x, X, lengthScale) {
  const squared = X.map((row) => row.reduce((sum, v, q) => sum + (v - x[q]) ** 2, 0) / lengthScale ** 2);
  let u;
  if (squared.includes(0)) {
    u = squared.map((s) => (s === 0 ? 1 : 0));
  } else {
    const log = squared.map((s) => -0.5 * s - Math.log(s));
    const most = log.reduce((a, b) => Math.max(a, b));
    u = log.map((v) => Math.exp(v - most));
  }
  const next = u.length > NEIGHBOURS ? [...u].sort((a, b) => b - a)[NEIGHBOURS] : 0;
  u = u.map((v) => Math.max(v - Math.max(next, NEGLIGIBLE), 0));
  const total = u.reduce((a, b) => a + b);
  return u.map((v) => v / total);
}

/** `D G / (4 cos(theta_i) cos(theta_o))` of GGX, by cosines of theta_i, theta_o and theta_d. */
export function microfacetLobe(alpha, ci, co, cd) {
  const a2 = alpha * alpha, cosine2 = Math.min(((ci + co) / (2 * cd)) ** 2, 1);
  const masked = ci * Math.sqrt(a2 + (1 - a2) * co * co) + co * Math.sqrt(a2 + (1 - a2) * ci * ci);
  return a2 / (Math.PI * (1 - (1 - a2) * cosine2) ** 2 * 2 * masked);
}

/** The roughness at a position, in equal ratios; the first two are given. */
export const roughnessAt = (position, [first, second]) => first * (second / first) ** position;

/** The position of the roughness at a share of the end: the peak of the average lobe goes in equal ratios. */
export function positionsBetween(start, end, share, [first, second]) {
  const mean = (a, b) => (1 - share) * a + share * b;
  const rise = Math.log(mean(start.strength, end.strength)) - mean(Math.log(start.strength), Math.log(end.strength));
  const found = mean(start.position, end.position) + (0.5 * rise) / Math.log(second / first);
  const [low, high] = [start.position, end.position].sort((a, b) => a - b);
  return Math.min(Math.max(found, low), high);
}

const REACH = 0.24; // of the materials' extent beyond them; the field of errors ends at 0.25

/** How far a point can go in each dimension of materials X: [least, most]. */
export function reachOf(X) {
  return X[0].map((_, q) => {
    const values = X.map((row) => row[q]), low = Math.min(...values), high = Math.max(...values);
    const room = REACH * (high - low || 1);
    return [low - room, high + room];
  });
}

/** A place no farther from the materials than a point can go. */
export const within = (reach, x) => x.map((v, q) => Math.min(Math.max(v, reach[q][0]), reach[q][1]));

/** Linear interpolation of y over increasing x, constant beyond the ends. */
export function interp(at, x, y) {
  if (!(at > x[0])) return y[0];
  const last = x.length - 1;
  if (at >= x[last]) return y[last];
  let low = 0, high = last;
  while (high - low > 1) {
    const middle = (low + high) >> 1;
    if (x[middle] <= at) low = middle; else high = middle;
  }
  return y[low] + ((y[high] - y[low]) * (at - x[low])) / (x[high] - x[low]);
}

/** Where t lies between increasing vertices: the one below, and the share of the one above. */
function segment(at, t) {
  const clipped = Math.min(Math.max(t, at[0]), at[at.length - 1]);
  let k = 0;
  while (k < at.length - 2 && at[k + 1] <= clipped) k++;
  return [k, (clipped - at[k]) / (at[k + 1] - at[k])];
}

const bytesOf = (text) => Uint8Array.from(atob(text), (c) => c.charCodeAt(0));

async function inflate(text) {
  const stream = new Blob([bytesOf(text)]).stream().pipeThrough(new DecompressionStream("gzip"));
  return new Response(stream).arrayBuffer();
}

/** A picture in text, its values as they are. */
const pictureIn = (text) =>
  createImageBitmap(new Blob([bytesOf(text)]), { premultiplyAlpha: "none", colorSpaceConversion: "none" });

function halfToFloat() {
  const table = new Float32Array(65536);
  for (let k = 0; k < 65536; k++) {
    const sign = k & 0x8000 ? -1 : 1, exponent = (k >> 10) & 31, fraction = k & 1023;
    if (exponent === 0) table[k] = sign * fraction * 2 ** -24;
    else table[k] = sign * (1 + fraction / 1024) * 2 ** (exponent - 15);
  }
  return table;
}

/** The materials of a page's data, and what they predict. */
export class Materials {
  static async load(data) {
    const { first, ratios, scales } = data.components;
    const [halves, steps] = [new Uint16Array(await inflate(first)), new Int8Array(await inflate(ratios))];
    const made = new Materials(data, halves, steps, scales, new Float32Array(await inflate(data.walks.cosines)));
    const float = (half) => made.packed.float[half];
    made.environments = await Promise.all(data.environments.map(async ({ radiance, ...rest }) => (
      { ...rest, radiance: Float32Array.from(new Uint16Array(await inflate(radiance)), float) })));
    made.surfaces = await Promise.all(data.surfaces.map((surface, k) => made._surface(surface, k)));
    made.thumbnails = { side: data.thumbnails.side, rgb: new Uint8Array(await inflate(data.thumbnails.rgb)) };
    return made;
  }

  /** The mean of a surface, with its textures: pictures, the brightest colour, and flakes, if any, with their facet. */
  async _surface({ latent, colours, brightest, normals, flakes }, k) {
    const rows = Array.from({ length: this.nComponents },
      (_, r) => this._unpack(this.count + k, r, 0, this.nPairs, new Float32Array(this.nPairs), 0, 1));
    const [colourPicture, normalPicture, flakePicture] =
      await Promise.all([colours, normals, ...(flakes ? [flakes.texture] : [])].map(pictureIn));
    const facets = flakes && { share: flakes.share, picture: flakePicture, facet: this._facet(flakes) };
    const textures = { colours: colourPicture, normals: normalPicture, brightest, flakes: facets };
    return Object.assign(this._tabulated(this.weights(latent), rows), { textures });
  }

  /** A rough mirror without colour. */
  _facet({ roughness, reflectance }) {
    const P = this.nPairs, roots = Float32Array.from({ length: P }, (_, p) => {
      const [ci, co, cd] = [0, 1, 2].map((row) => this.cosines[row * P + p]);
      return Math.cbrt(reflectance * microfacetLobe(roughness, ci, co, cd) * ci * co);
    });
    const flat = this.data.walks.toComponents.map((row) => row.reduce((sum, w) => sum + w, 0));
    return this._tabulated(Array(this.count).fill(0), flat.map((share) => roots.map((root) => share * root)));
  }

  /** The ball of a material that the page came with, as a canvas. */
  thumbnail(k) {
    const { side, rgb } = this.thumbnails, pixels = new Uint8ClampedArray(4 * side * side).fill(255), large = 4 * side;
    for (let p = 0; p < side * side; p++) for (let c = 0; c < 3; c++) pixels[4 * p + c] = rgb[3 * (k * side * side + p) + c];
    const [small, round] = [side, large].map((size) => Object.assign(document.createElement("canvas"), { width: size, height: size }));
    small.getContext("2d").putImageData(new ImageData(pixels, side, side), 0, 0);
    const context = round.getContext("2d");
    context.arc(large / 2, large / 2, large / 2, 0, 2 * Math.PI);
    context.clip();
    context.drawImage(small, 0, 0, large, large);
    return round;
  }

  constructor(data, halves, steps, scales, cosines) {
    this.data = data;
    this.cosines = cosines; // of wi, of wo, and of their difference angle, a row each
    this.count = data.names.length;
    this.nPairs = data.pairs.count;
    this.nGrid = data.pairs.grid;
    this.nNodes = data.basis.length;
    this.nComponents = data.basis[0].length;
    this.packed = { halves, steps, scales, float: halfToFloat() };
    const R = this.nComponents, beside = this.nPairs - this.nGrid;
    this.components = new Float32Array(this.count * R * beside); // [N, R, pairs beside the grid]
    for (let k = 0; k < this.count * R; k++) {
      const row = this.components.subarray(k * beside, (k + 1) * beside);
      this._unpack(Math.floor(k / R), k % R, this.nGrid, this.nPairs, row, 0, 1);
    }
    const { slices } = data.pairs;
    // Of the pairs beside the grid: those of the slices, of the gloss meter, of the geometry 45/0, and of the sphere.
    this.meterStart = slices.reduce((sum, slice) => sum + slice.angles.length, 0);
    this.spotStart = this.meterStart + data.pairs.glossWeights.length;
    this.sphereStart = this.spotStart + 1;
    this.nBeside = beside;
    this.sphere = { start: this.sphereStart, measure: data.pairs.sphereMeasure };
    this.spot = { start: this.spotStart, measure: [Math.PI] };
  }

  /** Write component r of material i at the pairs from start to stop into out, at first, first + stride, ... */
  _unpack(i, r, start, stop, out, first, stride) {
    const { halves, steps, scales, float } = this.packed, P = this.nPairs;
    const scale = r === 0 ? 1 : scales[i][r - 1] / 127, row = (i * (this.nComponents - 1) + r - 1) * P;
    for (let p = start, k = first; p < stop; p++, k += stride) {
      out[k] = float[halves[i * P + p]] * (r === 0 ? 1 : steps[row + p] * scale);
    }
    return out;
  }

  /** Components first to first + 3 of a material on the grid, (nGrid, 4); 0 beyond the last. */
  gridComponents(i, first) {
    const out = new Float32Array(4 * this.nGrid);
    for (let r = first; r < Math.min(first + 4, this.nComponents); r++) {
      this._unpack(i, r, 0, this.nGrid, out, r - first, 4);
    }
    return out;
  }

  /** Weights at a place of all materials, or of all but one. */
  weights(x, without = -1) {
    const { X, lengthScale } = this.data, u = blendWeights(x, X.filter((_, i) => i !== without), lengthScale);
    return without < 0 ? u : [...u.slice(0, without), 0, ...u.slice(without)];
  }

  index(name) {
    return this.data.names.indexOf(name);
  }

  /** The material whose place x is, or -1. */
  materialAt(x) {
    return this.data.X.findIndex((row) => row.every((v, q) => v === x[q]));
  }

  /** Weights of the components of all materials, (N R), on the path of a blend u at coordinate t. */
  pathComponents(u, t) {
    const total = new Float64Array(this.count * this.nComponents);
    u.forEach((share, i) => {
      if (share <= 0) return;
      const { at, weights } = this.data.paths.vertices[i];
      const [k, s] = segment(at, t);
      this._addSamples(total, weights[k], share * (1 - s));
      this._addSamples(total, weights[k + 1], share * s);
    });
    return total;
  }

  /** Add a vertex of a path, weights of samples (single bands of materials), to weights of components. */
  _addSamples(total, vertex, share) {
    const { sampleBasis } = this.data.paths, R = this.nComponents;
    for (const [n, w] of vertex) {
      const basis = sampleBasis[n % sampleBasis.length], row = Math.floor(n / sampleBasis.length) * R;
      for (let r = 0; r < R; r++) total[row + r] += share * w * basis[r];
    }
  }

  /** Sum of components by weights (N R) at the pairs beside the grid, from start to stop: a cube root of f times cosines. */
  combine(weights, start = 0, stop = this.nBeside) {
    const P = this.nBeside, out = new Float32Array(stop - start), rows = [];
    weights.forEach((w, row) => w !== 0 && rows.push(row));
    for (let k = 0; k < rows.length; k += 4) { // four rows at a time, which takes half as long as one by one
      const four = [0, 1, 2, 3].map((j) => rows[k + j] ?? rows[0]);
      const [wa, wb, wc, wd] = four.map((row, j) => (k + j < rows.length ? weights[row] : 0));
      const [a, b, c, d] = four.map((row) => this.components.subarray(row * P + start, row * P + stop));
      for (let p = 0; p < out.length; p++) out[p] += wa * a[p] + wb * b[p] + wc * c[p] + wd * d[p];
    }
    return out;
  }

  /** Reflectance of cube roots at the pairs of a probe, which is the sphere or the geometry 45/0. */
  measured({ start, measure }, roots) {
    const { amplitude } = this.data.pairs;
    let sum = 0;
    for (let p = 0; p < measure.length; p++) {
      const root = Math.max(roots[p] / amplitude[start + p], 0);
      sum += root ** 3 * measure[p];
    }
    return sum;
  }

  /** Cube roots at a probe's pairs of every vertex of every path, made when first asked for. */
  verticesAt(probe) {
    probe.inside ??= this.data.paths.vertices.map(({ weights }) => weights.map((vertex) => {
      const total = new Float64Array(this.count * this.nComponents);
      this._addSamples(total, vertex, 1);
      return this.combine(total, probe.start, probe.start + probe.measure.length);
    }));
    return probe.inside;
  }

  /** Path coordinates (J) that give a blend u a reflectance (J) at a probe, and the reflectance that they do give. */
  coordinatesOf(u, reflectance, probe = this.sphere) {
    const { last, vertices } = this.data.paths;
    const used = u.flatMap((share, i) => (share > 0 ? [i] : []));
    const inside = this.verticesAt(probe), roots = new Float32Array(probe.measure.length);
    const reached = (t) => {
      roots.fill(0);
      for (const i of used) {
        const [k, s] = segment(vertices[i].at, t), [a, b] = [inside[i][k], inside[i][k + 1]];
        const [from, to] = [u[i] * (1 - s), u[i] * s];
        for (let p = 0; p < roots.length; p++) roots[p] += from * a[p] + to * b[p];
      }
      return this.measured(probe, roots);
    };
    const grid = Array.from({ length: TABLE }, (_, k) => (last * k) / (TABLE - 1));
    const table = [];
    for (const t of grid) table.push(Math.max(reached(t), table[table.length - 1] ?? -Infinity));
    const coordinates = reflectance.map((requested) => {
      let at = interp(requested, table, grid);
      for (let step = 0; step < NEWTON_STEPS; step++) {
        const rise = interp(at + PROBE, grid, table) - interp(at - PROBE, grid, table);
        const slope = rise / (2 * PROBE);
        const move = slope > 1e-6 ? (requested - reached(at)) / slope : 0;
        at = Math.min(Math.max(at + Math.min(Math.max(move, -LARGEST_STEP), LARGEST_STEP), 0), last);
      }
      return at;
    });
    return { coordinates, reached: coordinates.map(reached) };
  }

  /**
   * What a place is made of: outputs as weights of all components (N R), and the matrix (J, M) from outputs to nodes.
   * Without a colour (J reflectances) materials are blended whole: the outputs are null, and stand for the components.
   */
  combination(u, reflectance) {
    if (!reflectance) return { outputs: null, toNodes: this.data.basis, coordinates: null, residual: 0 };
    const { coordinates, reached } = this.coordinatesOf(u, reflectance);
    return { ...this._onPath(u, coordinates), residual: Math.max(...reached.map((v, j) => Math.abs(v - reflectance[j]))) };
  }

  /** The combination at coordinates (J) of a blend's path, its cube roots times gains. */
  _onPath(u, coordinates, gains = coordinates.map(() => 1)) {
    const low = Math.min(...coordinates), high = Math.max(...coordinates);
    const isShort = coordinates.length <= PATH_NODES;
    const nodes = isShort ? coordinates
      : Array.from({ length: PATH_NODES }, (_, k) => low + ((high - low) * k) / (PATH_NODES - 1));
    const toNodes = coordinates.map((t, j) => nodes.map((_, k) => {
      if (isShort) return j === k ? gains[j] : 0;
      const position = high > low ? ((t - low) / (high - low)) * (PATH_NODES - 1) : 0;
      return gains[j] * Math.max(0, 1 - Math.abs(position - k));
    }));
    const outputs = nodes.map((t) => this.pathComponents(u, t).map((w) => (Math.abs(w) > LEAST_COMPONENT ? w : 0)));
    return { outputs, toNodes, coordinates, residual: 0 };
  }

  /** The prediction of a place, in a reflectance (J) or as materials blend, without one of them. */
  predict(x, reflectance = null, without = -1) {
    const u = this.weights(x, without);
    const isOwn = without < 0 && reflectance && this.materialAt(x) >= 0 && reflectance === this.data.reflectances[this.materialAt(x)];
    return new Prediction(this, u, this.combination(u, isOwn ? null : reflectance));
  }

  /** The prediction of a place at coordinates of its path, times gains, as `manifold locate` finds them. */
  predictIn(x, { coordinates, gains }) {
    const u = this.weights(x);
    return new Prediction(this, u, this._onPath(u, coordinates, gains));
  }

  /** The prediction of a place that has a CIELAB colour in the geometry 45/0: the blend's reflectance, smoothly tinted. */
  predictTinted(x, lab, without = -1) {
    const u = this.weights(x, without), { toSrgb, fromSrgb } = this.data;
    const blended = new Prediction(this, u, this.combination(u, null));
    const { coordinates } = this.coordinatesOf(u, tinted(blended.factor(), lab, toSrgb.D65, fromSrgb), this.spot);
    return new Prediction(this, u, this._onPath(u, coordinates));
  }

  /** Share of material b at t of the walk from a. */
  walkShare(a, b, t) {
    if (a < b) return 1 - this.walkShare(b, a, 1 - t);
    const shares = [0, ...this.data.walks.shares[a][b], 1], last = shares.length - 1;
    return interp(t * last, shares.map((_, k) => k), shares);
  }

  /** The step of the walk between two materials, as of `Manifold.interpolate`. */
  between({ from, to, t }) {
    const ends = [from, to].map((name) => this.index(name)), u = Array(this.count).fill(0);
    if (ends[0] === ends[1]) return this.predict(this.data.X[ends[0]]);
    const share = this.walkShare(...ends, t);
    [u[ends[0]], u[ends[1]]] = [1 - share, share];
    return this._tabulated(u, this._average(ends.map((i) => [i, u[i]])));
  }

  /** What has components (R, P) of its own, beside the weights of a place. */
  _tabulated(u, walked) {
    const values = walked.map((row) => row.subarray(this.nGrid, this.nPairs));
    return new Prediction(this, u, { outputs: null, toNodes: this.data.basis, coordinates: null, residual: 0, walked, values });
  }

  /** Components (R, P) of the average of materials whose highlights have another roughness. */
  _average(parts) {
    const { basis, walks } = this.data, P = this.nPairs, R = this.nComponents;
    const out = Array.from({ length: R }, () => new Float32Array(P));
    const own = parts.map(([i]) => out.map((_, r) => this._unpack(i, r, 0, P, new Float32Array(P), 0, 1)));
    const roughness = (k) => roughnessAt(k, walks.roughnesses);
    const [start, end] = parts.map(([i]) => ({ position: walks.positions[i], strength: walks.strengths[i] }));
    const position = positionsBetween(start, end, parts[1][1], walks.roughnesses), alpha = roughness(position);
    const kept = parts.map(([i]) => Math.max(1 - Math.abs(position - walks.positions[i]) / SHAPE_KEPT, 0));
    for (let p = 0; p < P; p++) {
      const [ci, co, cd] = [0, 1, 2].map((row) => this.cosines[row * P + p]);
      const weight = ci * co, schlick = (1 - cd) ** 5, moved = microfacetLobe(alpha, ci, co, cd);
      const lobes = parts.map(([i]) => microfacetLobe(roughness(walks.positions[i]), ci, co, cd));
      for (let j = 0; j < basis.length; j++) {
        let f = 0; // times weight
        parts.forEach(([i, share], k) => {
          let root = 0;
          for (let r = 0; r < R; r++) root += basis[j][r] * own[k][r][p];
          const fresnel = walks.normal[i][j] + (walks.grazing[i][j] - walks.normal[i][j]) * schlick;
          const value = Math.max(root, 0) ** 3, lobe = lobes[k] * fresnel * weight;
          const excess = Math.max(value - lobe - walks.base[i][j] * weight, 0);
          const explained = Math.min(value, lobe) + Math.min(excess, MOST_EXCESS * lobe);
          f += share * (value - explained + moved * ((kept[k] * explained) / lobes[k] + (1 - kept[k]) * walks.gain[i][j] * fresnel * weight));
        });
        const root = Math.cbrt(f);
        for (let r = 0; r < R; r++) out[r][p] += walks.toComponents[r][j] * root;
      }
    }
    return out;
  }

  /** Weights u of whole materials as weights of components (N R), per component. */
  wholeComponents(u) {
    const R = this.nComponents;
    return Array.from({ length: R }, (_, r) => {
      const weights = new Float64Array(this.count * R);
      u.forEach((share, i) => (weights[i * R + r] = share));
      return weights;
    });
  }
}

/** A place's weights u and what it is made of, as of `Materials.combination` or, walked, components; its slices and reflectance. */
export class Prediction {
  constructor(materials, u, { outputs, toNodes, coordinates, residual, walked = null, values }) {
    Object.assign(this, { materials, u, outputs, toNodes, coordinates, residual, walked });
    this.values = values ?? (outputs ?? materials.wholeComponents(u)).map((weights) => materials.combine(weights));
  }

  /** Luminance of f times cosines under an illuminant at the pairs beside the grid but the sphere's. */
  luminance(illuminant) {
    const rows = this.materials.data.toSrgb[illuminant].map(luminance);
    const out = new Float32Array(this.materials.sphereStart);
    this.toNodes.forEach((row, j) => {
      for (let p = 0; p < out.length; p++) {
        const root = row.reduce((sum, weight, m) => sum + weight * this.values[m][p], 0);
        out[p] += rows[j] * Math.max(root, 0) ** 3;
      }
    });
    return out;
  }

  /** Luminance of f over the angles of each slice. */
  slices(illuminant) {
    const { slices, amplitude } = this.materials.data.pairs, luminance = this.luminance(illuminant);
    let start = 0;
    return slices.map(({ incidence, angles }) => {
      const offset = start;
      start += angles.length;
      const f = angles.map((_, k) => luminance[offset + k] / amplitude[offset + k] ** 3);
      return { incidence, angles, f };
    });
  }

  /** Gloss units at 60 degrees, of the luminance under D65. */
  gloss() {
    const { data: { pairs: { glossWeights, amplitude } }, meterStart } = this.materials, luminance = this.luminance("D65");
    return glossWeights.reduce((sum, w, k) => sum + (w * luminance[meterStart + k]) / amplitude[meterStart + k] ** 3, 0);
  }

  /** Reflectance factor in the geometry 45/0 at the nodes (J). */
  factor() {
    const { materials, values } = this, { spot } = materials;
    return this.toNodes.map((row) => materials.measured(spot, [row.reduce((sum, w, m) => sum + w * values[m][spot.start], 0)]));
  }

  /** Reflectance at 8 degrees, specular included, at the nodes (J). */
  reflectance() {
    const { sphereStart, nBeside } = this.materials, count = nBeside - sphereStart;
    return this.toNodes.map((row) => {
      const roots = new Float32Array(count);
      row.forEach((w, m) => {
        if (w !== 0) for (let p = 0; p < count; p++) roots[p] += w * this.values[m][sphereStart + p];
      });
      return this.materials.measured(this.materials.sphere, roots);
    });
  }
}

/** Depth of the deepest minimum of a profile, relative to the lower of the maxima on its two sides. */
export function valleyDepth(f) {
  let deepest = 0;
  for (let k = 1; k < f.length - 1; k++) {
    const side = Math.min(Math.max(...f.slice(0, k)), Math.max(...f.slice(k + 1)));
    if (side > 0) deepest = Math.max(deepest, 1 - f[k] / side);
  }
  return deepest;
}

/** The valley of a slice within 20 degrees of the mirror direction. */
export const highlightValley = ({ incidence, angles, f }) => valleyDepth(f.filter((_, k) => Math.abs(angles[k] - incidence) <= 20));

/** A regular grid over the map, linear between its nodes; null outside of it. */
export function fieldAt(field, x) {
  if (!field) return null;
  const n = field.nodes, Q = x.length;
  const base = [], part = [];
  for (let q = 0; q < Q; q++) {
    const at = ((x[q] - field.low[q]) / (field.high[q] - field.low[q])) * (n - 1);
    if (!(at >= 0 && at <= n - 1)) return null;
    base.push(Math.min(Math.floor(at), n - 2));
    part.push(at - base[q]);
  }
  let sum = 0;
  for (let corner = 0; corner < 1 << Q; corner++) {
    let index = 0, weight = 1;
    for (let q = 0; q < Q; q++) {
      const up = (corner >> q) & 1;
      index = index * n + base[q] + up;
      weight *= up ? part[q] : 1 - part[q];
    }
    sum += weight * field.values[index];
  }
  return sum;
}

const NUMBER = /^[+-]?(\d+([.,]\d*)?|[.,]\d+)(e[+-]?\d+)?$/i;

const WAVELENGTH_HEAD = /^(wavelengths?|lambda|λ|wl|wvl|nm)[\s([/_]*(in )?(nm)?[\s)\]]*$/i;
const REFLECTANCE_HEAD = /^\W*(spectral |total |diffuse )?(reflect|refl\b|reflexion|remission|r\b)/i;
const OTHER_HEAD = /abs|trans|radian|\brad\b|power|flux|intens|count|\bdn\b|log|lg\b|\bln\b|^\W*[at]\W*$|k\s*\/\s*s|f\s*\(r/i;
const UNCERTAIN_HEAD = /\b(std|stdev|sd|sigma|dev|deviation|uncertainty|error)\b/i;

/** Cells of a line between separators; between blanks where it is null, but not those in or before brackets. */
function cellsOf(line, separator) {
  const cells = separator === null
    ? (line.match(/"[^"]*"|(?:[^\s"(\[]|\s*[(\[][^()\[\]]*[)\]]|[(\[])+/g) ?? []).map((cell) => cell.replace(/^,+|,+$/g, ""))
    : line.split(separator);
  const plain = cells.map((cell) => cell.trim().replace(/^"|"$/g, "").trim());
  while (plain.length && !plain[plain.length - 1]) plain.pop();
  return separator === null ? plain.filter((cell) => cell) : plain;
}

/** What separates the cells of lines: `;`, a tab, a comma, or null for blanks, between which commas are decimal. */
function separatorOf(lines) {
  for (const separator of [";", "\t"]) if (lines.every((line) => line.includes(separator))) return separator;
  if (!lines.every((line) => line.includes(","))) return null;
  const rows = lines.map((line) => cellsOf(line, null));
  return rows.every((row) => row.length > 1 && row.every((cell) => NUMBER.test(cell))) ? null : ",";
}

/** The column of reflectances among those of headings, and whether they are percent. Throws an Error if headings are not understood. */
function reflectanceColumn(heads) {
  const shown = heads.join(", ").slice(0, 60);
  const nm = heads.findIndex((head) => WAVELENGTH_HEAD.test(head));
  if (nm !== 0) throw new Error(`expected the first column to be wavelengths in nm, found ${shown}`);
  const others = heads.map((head, k) => k).slice(1).filter((k) => !UNCERTAIN_HEAD.test(heads[k]));
  let own = others.filter((k) => REFLECTANCE_HEAD.test(heads[k]) && !OTHER_HEAD.test(heads[k]));
  if (!own.length && others.length === 1 && !OTHER_HEAD.test(heads[others[0]])) own = others;
  if (own.length !== 1) throw new Error(`expected one column of reflectance, found ${shown}`);
  return { column: own[0], isPercent: /%|per ?cent/i.test(heads[own[0]]) };
}

/** Wavelengths and reflectances of a text of columns, as `manifold --reflectance` reads it, in nm. Throws an Error with a message for the user. */
export function readReflectance(text) {
  const lines = text.replace(/^\ufeff/, "").split(/\r\n|\r|\n/).filter((line) => line.trim());
  const isComment = (line) => line.trimStart().startsWith("#");
  const first = lines.findIndex((line) => !isComment(line) && /^\s*"?[-+]?[.,]?\d/.test(line));
  const data = first < 0 ? [] : lines.slice(first).filter((line) => !isComment(line));
  if (data.length < 2) throw new Error("expected at least two rows of wavelength in nm and reflectance, such as 400;0.1");
  const separator = separatorOf(data.filter((line) => /^\s*"?[-+]?[.,]?\d/.test(line)));
  const width = cellsOf(data[0], separator).length;
  let { column, isPercent } = { column: 1, isPercent: false };
  const above = first > 0 ? cellsOf(lines[first - 1].replace(/^[#\s]+/, ""), separator) : [];
  if (above.length === width && (!isComment(lines[first - 1]) || above.some((head) => WAVELENGTH_HEAD.test(head)))) {
    ({ column, isPercent } = reflectanceColumn(above));
  } else if (width > 2) {
    throw new Error(`expected two columns, or headings that name them, found ${width}`);
  } else if (above.length && OTHER_HEAD.test(lines[first - 1])) {
    throw new Error(`expected reflectance, found ${lines[first - 1].trim().slice(0, 60)}`);
  }
  const rows = data.map((line) => {
    const cells = cellsOf(line, separator), own = [cells[0], cells[column]];
    if (cells.length !== width || !own.every((cell) => NUMBER.test(cell ?? ""))) {
      throw new Error(`expected a wavelength in nm and a reflectance in the line “${line.trim().slice(0, 40)}”`);
    }
    return own.map((cell) => Number(cell.replace(",", ".")));
  });
  rows.sort((a, b) => a[0] - b[0]);
  const nm = rows.map((row) => row[0]), values = rows.map((row) => (isPercent ? row[1] / 100 : row[1]));
  if (nm.some((v, k) => k && v === nm[k - 1])) throw new Error("a wavelength appears twice");
  if (nm[0] < 100 || nm[nm.length - 1] > 10000) throw new Error("expected wavelengths in nm");
  if (Math.min(...values) < 0 || Math.max(...values) > 1) {
    throw new Error("expected reflectances from 0 to 1; divide percent by 100");
  }
  if (Math.min(nm[nm.length - 1], 700) - Math.max(nm[0], 400) < 150) {
    throw new Error("expected most of 400 to 700 nm to be covered");
  }
  return { nm, values };
}
