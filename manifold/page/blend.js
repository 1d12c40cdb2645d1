// The table of a prediction on the grid, in WebGL2: (sum_i v_i f_i^(1/3))^3 in every band, as cube roots of colours.

import { bindTexture, drawInto, makeProgram, makeTarget, makeTexture } from "./webgl.js";

const MOST_TEXELS = 4096; // of weights in a uniform block: 64 KB; a browser may allow less
const LEAST_SHARE = 1e-3; // of a material of a coarse picture

const range = (count) => [...Array(count).keys()];

/**
 * Sums of the materials' components, as texels of four outputs; of outputs, values at the nodes; of their cubes, a colour.
 * A material of the blend has its corner in the texture, then its weights: one for all of its components where
 * isWhole, else of its components one by one for four outputs each.
 */
const blendShader = ({ groups, parts, nodes, capacity, stride, isWhole }) => `
uniform sampler2D materials; // a block of the grid per material and four components, its blocks side by side
layout(std140) uniform Blend { vec4 texels[${capacity}]; };
uniform int count, columns;
uniform vec4 toNodes[${nodes * parts}];
uniform vec3 toSrgb[${nodes}];
out vec4 result;

void main() {
  ivec2 at = ivec2(gl_FragCoord.xy);
  vec4 ${range(parts).map((m) => `sum${m} = vec4(0.0)`).join(", ")};
  for (int k = 0; k < count; k++) {
    vec4 own = texels[k * ${stride}];
    vec4 c;
    ${range(groups).map((g) => `
    c = texelFetch(materials, at + ivec2(own.xy) + ivec2(${g} * columns, 0), 0);
    ${isWhole ? `sum${g} += own.z * c;` : range(parts).map((m) =>
      `sum${m} += ${[..."xyzw"].map((r, q) => `c.${r} * texels[k * ${stride} + ${1 + (m * groups + g) * 4 + q}]`).join(" + ")};`,
    ).join("\n    ")}`).join("")}
  }
  vec3 colour = vec3(0.0);
  float root;
  ${range(nodes).map((j) => `
  root = max(${range(parts).map((m) => `dot(toNodes[${j * parts + m}], sum${m})`).join(" + ")}, 0.0);
  colour += root * root * root * toSrgb[${j}];`).join("")}
  result = vec4(sign(colour) * pow(abs(colour), vec3(1.0 / 3.0)), 1.0);
}`;

/** Draws tables of predictions, from the components of all materials on the grid. */
export class BlendRenderer {
  /** Whether the materials fit into one texture. */
  static fits(gl, materials) {
    return BlendRenderer._layout(gl, materials).height <= gl.getParameter(gl.MAX_TEXTURE_SIZE);
  }

  static _layout(gl, { data, count, nComponents }) {
    const [h, d, columns] = data.grid.shape, rows = h * d, groups = Math.ceil(nComponents / 4);
    const places = count + 1; // the last is for the step of a walk
    const across = Math.min(Math.floor(gl.getParameter(gl.MAX_TEXTURE_SIZE) / (columns * groups)), places);
    return { rows, columns, groups, across, height: rows * Math.ceil(places / across) };
  }

  constructor(gl, materials) {
    this.gl = gl;
    this.materials = materials;
    this.layout = BlendRenderer._layout(gl, materials);
    this.capacity = Math.min(gl.getParameter(gl.MAX_UNIFORM_BLOCK_SIZE) / 16, MOST_TEXELS);
    this.programs = new Map(); // by the number of texels of outputs; 0 where materials are blended whole
    this.block = gl.createBuffer();
    gl.bindBuffer(gl.UNIFORM_BUFFER, this.block);
    gl.bufferData(gl.UNIFORM_BUFFER, 16 * this.capacity, gl.DYNAMIC_DRAW);
    gl.bindBufferBase(gl.UNIFORM_BUFFER, 0, this.block);
    this._upload();
  }

  _upload() {
    const { gl, materials } = this, { columns, groups, across, height } = this.layout;
    const options = { filter: gl.NEAREST, wrap: gl.CLAMP_TO_EDGE };
    this.components = makeTexture(gl, across * groups * columns, height, null, options);
    for (let i = 0; i < materials.count; i++) this._fill(i, (first) => materials.gridComponents(i, first));
  }

  /** Write the bound texture's block i, four components at a time. */
  _fill(i, texelsFrom) {
    const { gl } = this, { rows, columns, groups } = this.layout, [x, y] = this._corner(i);
    for (let g = 0; g < groups; g++) {
      gl.texSubImage2D(gl.TEXTURE_2D, 0, x + g * columns, y, columns, rows, gl.RGBA, gl.FLOAT, texelsFrom(4 * g));
    }
  }

  /** Components first to first + 3 of a step of a walk on the grid, (nGrid, 4). */
  _texels(walked, first) {
    const { nGrid } = this.materials, out = new Float32Array(4 * nGrid);
    walked.slice(first, first + 4).forEach((row, c) => {
      for (let p = 0; p < nGrid; p++) out[4 * p + c] = row[p];
    });
    return out;
  }

  _corner(i) {
    const { rows, columns, groups, across } = this.layout;
    return [(i % across) * groups * columns, Math.floor(i / across) * rows];
  }

  /** A table that `draw` fills: cube roots of colours, rows of phi_d over theta_d within theta_h. */
  table() {
    const { rows, columns } = this.layout;
    return makeTarget(this.gl, columns, rows, { wrap: this.gl.CLAMP_TO_EDGE });
  }

  /** Fill a table by a prediction under an illuminant; coarse: without the materials of least share. */
  draw(table, { outputs, toNodes, u, walked }, illuminant, isCoarse) {
    const { gl, layout } = this, { toSrgb } = this.materials.data;
    const parts = outputs === null ? 0 : Math.ceil(outputs.length / 4), used = parts || layout.groups;
    if (!this.programs.has(parts)) this.programs.set(parts, this._program(parts, toNodes.length));
    const { at, handle, stride } = this.programs.get(parts);
    let all = outputs === null ? new Map(u.entries()) : sizes(outputs, this.materials);
    if (walked) {
      gl.activeTexture(gl.TEXTURE0);
      gl.bindTexture(gl.TEXTURE_2D, this.components);
      this._fill(this.materials.count, (first) => this._texels(walked, first));
      all = new Map([[this.materials.count, 1]]);
    }
    const { shares, scale } = largest(all, isCoarse ? LEAST_SHARE : 0, Math.floor(this.capacity / stride));
    const texels = new Float32Array(4 * stride * shares.length);
    shares.forEach(([i], k) => texels.set(this._corner(i), 4 * stride * k));
    if (outputs === null) shares.forEach(([, share], k) => (texels[4 * stride * k + 2] = scale * share));
    else this._setWeights(texels, stride, shares, scale, outputs);
    gl.useProgram(handle);
    gl.bindBuffer(gl.UNIFORM_BUFFER, this.block);
    gl.bufferSubData(gl.UNIFORM_BUFFER, 0, texels);
    bindTexture(gl, { at }, "materials", 0, this.components);
    gl.uniform1i(at("count"), shares.length);
    gl.uniform1i(at("columns"), layout.columns);
    gl.uniform3fv(at("toSrgb"), toSrgb[illuminant].flat());
    gl.uniform4fv(at("toNodes"), toNodes.flatMap((row) => [...row, ...Array(4 * used - row.length).fill(0)]));
    drawInto(gl, table);
  }

  _program(parts, nodes) {
    const { gl, capacity, layout: { groups } } = this;
    const stride = 1 + 4 * groups * parts;
    const shader = blendShader({ groups, parts: parts || groups, nodes, capacity, stride, isWhole: parts === 0 });
    return { ...makeProgram(gl, shader), stride };
  }

  _setWeights(texels, stride, shares, scale, outputs) {
    const { layout: { groups }, materials: { nComponents } } = this;
    const place = new Map(shares.map(([i], k) => [i, stride * k + 1]));
    for (const [i, at] of place) {
      outputs.forEach((weights, m) => {
        const first = 4 * (at + Math.floor(m / 4) * groups * 4) + (m % 4);
        for (let r = 0; r < nComponents; r++) texels[first + 4 * r] = scale * weights[i * nComponents + r];
      });
    }
  }
}

/** Of shares those above the least one, at most so many, and the scale that makes up for what is left out. */
function largest(all, least, most) {
  const sum = (shares) => shares.reduce((total, [, share]) => total + share, 0);
  const used = [...all].filter(([, share]) => share > 0), total = sum(used);
  const shares = used.filter(([, share]) => share > least * total).sort((a, b) => b[1] - a[1]).slice(0, most);
  return { shares, scale: total / (sum(shares) || 1) };
}

/** How much of each material is in outputs. */
function sizes(outputs, { count, nComponents }) {
  const total = new Float64Array(count);
  for (const weights of outputs) weights.forEach((w, row) => (total[Math.floor(row / nComponents)] += Math.abs(w)));
  return new Map(total.entries());
}
