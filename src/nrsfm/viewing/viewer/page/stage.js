// The 3D picture: points, triangles or lines of one frame, and the cameras, drawn by WebGL.

import { fromRows, multiply, parallel, perspective, translation, turntable } from "./matrix.js";
import { cameraLines } from "./cameras.js";
import { coarser } from "./coarse.js";
import { normalsOf } from "./normals.js";
import { inGoodOrder } from "./order.js";

const SLOPE = Math.tan((11 * Math.PI) / 180); // half the field of view
const OVER = new Float32Array([-1, 0, 0, 0, 0, -1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1]); // upside down
const FEW_PER_PIXEL = 0.1; // triangles
export const START = { yaw: 0.42, pitch: 0.16 };

// One program for each way to colour, lit or not: without a graphics card every step in it counts.
const vertexText = (kind, lit) => `#version 300 es
#define ${kind.toUpperCase()}
${lit ? "#define LIT" : ""}
in vec3 position;
uniform mat4 whole;
uniform float pointScale, pointLeast, pointMost;
out mediump vec3 colour;
#ifdef LIT
in vec3 normal; uniform mat3 turn; uniform float lit;
#endif
#ifdef PLAIN
uniform vec3 plain;
#endif
#ifdef FIXED
in vec4 fixedColour;
#endif
#ifdef SCALE
in float stepOfScale; uniform vec3 grey; uniform sampler2D map;
#endif
#ifdef DEPTH
uniform vec3 depthRow; uniform vec2 depthRange; uniform sampler2D map;
#endif
void main() {
  gl_Position = whole * vec4(position, 1.0);
  gl_PointSize = clamp(pointScale / gl_Position.w, pointLeast, pointMost);
#ifdef PLAIN
  vec3 base = plain;
#endif
#ifdef FIXED
  vec3 base = fixedColour.rgb;
#endif
#ifdef SCALE
  vec3 base = stepOfScale > 254.5 ? grey : texelFetch(map, ivec2(int(stepOfScale), 0), 0).rgb;
#endif
#ifdef DEPTH
  float share = clamp((dot(depthRow, position) - depthRange.x) / (depthRange.y - depthRange.x), 0.0, 1.0);
  vec3 base = texelFetch(map, ivec2(int(share * 254.0 + 0.5), 0), 0).rgb;
#endif
#ifdef LIT
  vec3 n = turn * normal;
  n *= inversesqrt(max(dot(n, n), 1e-12));
  if (n.z < 0.0) n = -n;
  base *= mix(1.0, 0.40 + 0.44 * n.z + 0.24 * max(dot(n, vec3(-0.48, 0.62, 0.62)), 0.0), lit);
#endif
  colour = base;
}`;
const FRAGMENT = `#version 300 es
precision mediump float;
in vec3 colour; uniform float disc; out vec4 shown;
void main() {
  if (disc > 0.5) { vec2 d = gl_PointCoord - 0.5; if (dot(d, d) > 0.25) discard; }
  shown = vec4(colour, 1.0);
}`;
const LINE_VERTEX = `#version 300 es
in vec3 position; uniform mat4 whole;
void main() { gl_Position = whole * vec4(position, 1.0); }`;
const LINE_FRAGMENT = `#version 300 es
precision mediump float; uniform vec4 ink; out vec4 shown; void main() { shown = ink; }`;

export class Stage {
  constructor(canvas, scene) {
    this.canvas = canvas;
    this.scene = scene;
    this.software = drawsInSoftware();
    // Smooth edges cost a processor without a graphics card twice the time.
    const gl = canvas.getContext("webgl2", { alpha: false, antialias: !this.software, powerPreference: "high-performance" });
    if (!gl) throw new Error("This browser does not offer WebGL 2, which the view is drawn with.");
    this.gl = gl;
    this.quality = 1;
    this.radius = scene.radius / scene.half;
    this.upright = fromRows(scene.upright);
    this.toMiddle = translation(...scene.middle.map((value) => -value));
    this.programs = new Map();
    this.lineProgram = makeProgram(gl, LINE_VERTEX, LINE_FRAGMENT);
    this.maps = Object.fromEntries(Object.entries(scene.maps).map(([name, numbers]) => [name, makeMap(gl, numbers)]));
    this.fixed = {};
    this.cameraLines = cameraLines(scene, this.radius);
    this.cameraBuffer = fill(gl, gl.ARRAY_BUFFER, this.cameraLines.vertices);
    this.look = { shape: "points", colour: scene.colours[0], reference: "object", cameras: false, size: 1, parallel: false, over: false };
    this.theme = { paper: [1, 1, 1], grey: [0.7, 0.7, 0.7], accent: [0.2, 0.4, 0.7], ink: [0, 0, 0], plain: [0.6, 0.7, 0.8] };
    this.reset();
  }

  reset(yaw = START.yaw, pitch = START.pitch) {
    Object.assign(this, { yaw, pitch, zoom: 1, pan: [0, 0] });
  }

  setFaces(faces) {
    this.faces = inGoodOrder(faces, this.scene.points);
    this.faceBuffer = fill(this.gl, this.gl.ELEMENT_ARRAY_BUFFER, this.faces);
    this.coarse = null;
  }

  setEdges(edges) {
    this.edges = edges;
    this.edgeBuffer = fill(this.gl, this.gl.ELEMENT_ARRAY_BUFFER, edges);
  }

  setFixed(name, colours) {
    this.fixed[name] = fill(this.gl, this.gl.ARRAY_BUFFER, colours);
  }

  // Graphics memory of a frame that is no longer kept.
  forget(entry) {
    this.gl.deleteBuffer(entry.buffer ?? null);
    this.gl.deleteBuffer(entry.normalBuffer ?? null);
  }

  resize() {
    const ratio = Math.min(window.devicePixelRatio || 1, 2) * this.quality;
    const width = Math.max(1, Math.round(this.canvas.clientWidth * ratio));
    const height = Math.max(1, Math.round(this.canvas.clientHeight * ratio));
    if (this.canvas.width !== width || this.canvas.height !== height) Object.assign(this.canvas, { width, height });
    this.ratio = ratio;
  }

  // How far from the middle everything shown reaches.
  get reach() {
    return this.look.cameras && this.look.reference === "object" ? Math.max(this.radius, this.cameraLines.reach) : this.radius;
  }

  matrices(frame) {
    const { reference } = this.look;
    const turned = reference === "camera" ? fromRows(this.scene.rotations, 9 * frame, [1, -1, -1]) : this.upright;
    const model = multiply(this.look.over ? multiply(OVER, turned) : turned, this.toMiddle);
    const aspect = this.canvas.width / this.canvas.height;
    const fit = (1.06 * this.reach) / Math.min(1, aspect) / this.zoom; // half the height of what is seen in the middle
    const distance = fit / Math.sin(Math.atan(SLOPE));
    this.perPixel = (2 * fit) / (this.canvas.height / this.ratio);
    const turn = turntable(this.yaw, this.pitch);
    const view = multiply(translation(this.pan[0], this.pan[1], -distance), turn);
    const deep = 2 * Math.max(this.reach, this.radius) + 1;
    const near = Math.max(distance - deep, 0.02 * distance);
    const clip = this.look.parallel
      ? parallel(fit, aspect, near, distance + deep)
      : perspective(SLOPE, aspect, near, distance + deep);
    const pixels = this.canvas.height / 2 / (this.look.parallel ? fit : SLOPE);
    return { model, view, clip, pixels };
  }

  draw(frame, entry, rowOffset) {
    const { gl, look } = this;
    this.resize();
    gl.viewport(0, 0, this.canvas.width, this.canvas.height);
    gl.clearColor(...this.theme.paper, 1);
    gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT);
    gl.enable(gl.DEPTH_TEST);
    const matrices = this.matrices(frame);
    if (entry) this.drawShape(frame, entry, rowOffset, matrices);
    if (look.cameras) this.drawCameras(frame, matrices);
  }

  drawShape(frame, entry, rowOffset, { model, view, clip, pixels }) {
    const { gl, scene, look, theme } = this;
    const { kind, map, name } = look.colour;
    const lit = Boolean(this.faces) && look.shape !== "lines";
    const program = this.programFor(kind, lit);
    const { uniforms: u, attributes: a } = program;
    gl.useProgram(program.program);
    const placed = multiply(view, model), whole = multiply(clip, placed);
    gl.uniformMatrix4fv(u.whole, false, whole);
    for (let at = 0; at < 4; at++) gl.disableVertexAttribArray(at);

    entry.buffer ??= fill(gl, gl.ARRAY_BUFFER, entry.data);
    gl.bindBuffer(gl.ARRAY_BUFFER, entry.buffer);
    point(gl, a.position, 3, gl.SHORT, true, 8, 0);
    if (map) gl.bindTexture(gl.TEXTURE_2D, this.maps[map]);
    if (kind === "plain") gl.uniform3fv(u.plain, theme.plain);
    if (kind === "scale") {
      gl.uniform3fv(u.grey, theme.grey);
      point(gl, a.stepOfScale, 1, gl.UNSIGNED_BYTE, false, 0, rowOffset);
    }
    if (kind === "depth") {
      gl.uniform3fv(u.depthRow, scene.rotations.slice(9 * frame + 6, 9 * frame + 9).map((value) => value * scene.half));
      gl.uniform2fv(u.depthRange, scene.depth);
    }
    if (kind === "fixed") {
      gl.bindBuffer(gl.ARRAY_BUFFER, this.fixed[name]);
      point(gl, a.fixedColour, 4, gl.UNSIGNED_BYTE, true, 0, 0);
    }
    if (lit) {
      entry.normalBuffer ??= fill(gl, gl.ARRAY_BUFFER, normalsOf(entry.positions, this.faces));
      gl.bindBuffer(gl.ARRAY_BUFFER, entry.normalBuffer);
      point(gl, a.normal, 3, gl.BYTE, true, 4, 0);
      gl.uniformMatrix3fv(u.turn, false, [0, 1, 2, 4, 5, 6, 8, 9, 10].map((k) => placed[k]));
      gl.uniform1f(u.lit, kind === "plain" ? 1 : 0.55); // where colours are numbers, light must not change them much
    }

    const size = look.size * 1.8 * (scene.spacing / scene.half) * pixels;
    gl.uniform1f(u.pointScale, size);
    gl.uniform1f(u.pointLeast, 1.6 * this.ratio);
    gl.uniform1f(u.pointMost, 13 * look.size * this.ratio);
    if (look.shape === "surface" && this.faces) {
      gl.uniform1f(u.disc, 0);
      const { buffer, count } = this.triangles(entry);
      gl.bindBuffer(gl.ELEMENT_ARRAY_BUFFER, buffer);
      gl.drawElements(gl.TRIANGLES, count, gl.UNSIGNED_INT, 0);
      return;
    }
    const distance = look.parallel ? 1 : -view[14];
    gl.uniform1f(u.disc, Math.min(size / distance, 13 * look.size * this.ratio) > 3 ? 1 : 0);
    gl.drawArrays(gl.POINTS, 0, scene.points);
    if (look.shape === "lines" && this.edges) {
      gl.uniform1f(u.disc, 0);
      gl.bindBuffer(gl.ELEMENT_ARRAY_BUFFER, this.edgeBuffer);
      this.thick(u.whole, whole, () => gl.drawElements(gl.LINES, this.edges.length, gl.UNSIGNED_INT, 0));
    }
  }

  // All triangles, or half of them where the picture is coarse and they are hardly larger than its pixels.
  triangles({ positions }) {
    const { gl, faces, canvas } = this;
    if (this.quality >= 1 || faces.length / 3 < canvas.width * canvas.height * FEW_PER_PIXEL)
      return { buffer: this.faceBuffer, count: faces.length };
    if (!this.coarse) {
      const fewer = coarser(faces, positions);
      this.coarse = { buffer: fill(gl, gl.ELEMENT_ARRAY_BUFFER, fewer), count: fewer.length };
    }
    return this.coarse;
  }

  programFor(kind, lit) {
    const key = `${kind} ${lit}`;
    if (!this.programs.has(key)) this.programs.set(key, makeProgram(this.gl, vertexText(kind, lit), FRAGMENT));
    return this.programs.get(key);
  }

  drawCameras(frame, { model, view, clip }) {
    const { gl, theme, cameraLines: lines } = this;
    const { uniforms: u, attributes: a } = this.lineProgram;
    gl.useProgram(this.lineProgram.program);
    const whole = multiply(clip, multiply(view, model));
    gl.uniformMatrix4fv(u.whole, false, whole);
    gl.bindBuffer(gl.ARRAY_BUFFER, this.cameraBuffer);
    point(gl, a.position, 3, gl.FLOAT, false, 0, 0);
    gl.enable(gl.BLEND);
    gl.blendFunc(gl.SRC_ALPHA, gl.ONE_MINUS_SRC_ALPHA);
    if (this.look.reference === "object") {
      gl.uniform4f(u.ink, ...theme.ink, 0.28);
      for (let f = 0; f < this.scene.frames; f += lines.every) gl.drawArrays(gl.LINES, f * lines.each, lines.each);
      gl.uniform4f(u.ink, ...theme.accent, 0.75);
      gl.drawArrays(gl.LINE_STRIP, lines.path, this.scene.frames);
    }
    gl.uniform4f(u.ink, ...theme.accent, 1);
    this.thick(u.whole, whole, () => gl.drawArrays(gl.LINES, frame * lines.each, lines.each));
    gl.disable(gl.BLEND);
  }

  // WebGL's lines are one pixel wide: drawn again, a little beside, they are wider.
  thick(place, whole, drawLines) {
    const across = (1.4 * this.ratio) / this.canvas.width, down = (1.4 * this.ratio) / this.canvas.height;
    for (const [x, y] of [[0, 0], [1, 0], [-1, 0], [0, 1], [0, -1]]) {
      this.gl.uniformMatrix4fv(place, false, multiply(translation(x * across, y * down, 0), whole));
      drawLines();
    }
  }
}

function drawsInSoftware() {
  const gl = document.createElement("canvas").getContext("webgl2");
  if (!gl) return false;
  const known = gl.getExtension("WEBGL_debug_renderer_info");
  const name = String(gl.getParameter(known ? known.UNMASKED_RENDERER_WEBGL : gl.RENDERER));
  gl.getExtension("WEBGL_lose_context")?.loseContext();
  return /swiftshader|llvmpipe|softpipe|basic render|software/i.test(name);
}

function makeProgram(gl, vertex, fragment) {
  const program = gl.createProgram();
  for (const [type, text] of [[gl.VERTEX_SHADER, vertex], [gl.FRAGMENT_SHADER, fragment]]) {
    const shader = gl.createShader(type);
    gl.shaderSource(shader, text);
    gl.compileShader(shader);
    if (!gl.getShaderParameter(shader, gl.COMPILE_STATUS)) throw new Error(gl.getShaderInfoLog(shader));
    gl.attachShader(program, shader);
  }
  gl.linkProgram(program);
  if (!gl.getProgramParameter(program, gl.LINK_STATUS)) throw new Error(gl.getProgramInfoLog(program));
  const names = (count, get) => Array.from({ length: gl.getProgramParameter(program, count) }, (_, k) => get(k).name);
  const uniforms = names(gl.ACTIVE_UNIFORMS, (k) => gl.getActiveUniform(program, k));
  const attributes = names(gl.ACTIVE_ATTRIBUTES, (k) => gl.getActiveAttrib(program, k));
  return {
    program,
    uniforms: Object.fromEntries(uniforms.map((name) => [name, gl.getUniformLocation(program, name)])),
    attributes: Object.fromEntries(attributes.map((name) => [name, gl.getAttribLocation(program, name)])),
  };
}

function makeMap(gl, numbers) {
  const texture = gl.createTexture();
  gl.bindTexture(gl.TEXTURE_2D, texture);
  gl.pixelStorei(gl.UNPACK_ALIGNMENT, 1);
  gl.texImage2D(gl.TEXTURE_2D, 0, gl.RGB8, numbers.length / 3, 1, 0, gl.RGB, gl.UNSIGNED_BYTE, new Uint8Array(numbers));
  for (const side of [gl.TEXTURE_MIN_FILTER, gl.TEXTURE_MAG_FILTER]) gl.texParameteri(gl.TEXTURE_2D, side, gl.NEAREST);
  return texture;
}

function fill(gl, target, data) {
  const buffer = gl.createBuffer();
  gl.bindBuffer(target, buffer);
  gl.bufferData(target, data, gl.STATIC_DRAW);
  return buffer;
}

function point(gl, at, size, type, normalised, stride, offset) {
  if (at === undefined) return;
  gl.enableVertexAttribArray(at);
  gl.vertexAttribPointer(at, size, type, normalised, stride, offset);
}
