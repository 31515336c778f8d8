"use strict";
/* The page of svo-dump --html: unpacks the octrees, puts them into textures and draws them with trace.glsl. What the data
 * looks like is said in docs/format/html.md. Tests and the curious can use window.svokit. */
(async function () {
const meta = JSON.parse(document.getElementById("meta").textContent);
const canvas = document.getElementById("view");
const element = id => document.getElementById(id);
const WIDTH = 4096;

function problem(text) {
    element("problem").textContent = text;
    element("problem").hidden = false;
    throw new Error(text);
}

/* ---- the data ------------------------------------------------------------------------------------------------------ */

async function unpack() {
    const text = atob(element("data").textContent.trim()), bytes = new Uint8Array(text.length);
    for (let i = 0; i < text.length; i++) bytes[i] = text.charCodeAt(i);
    element("data").textContent = "";
    if (typeof DecompressionStream === "undefined") problem("This browser cannot decompress (DecompressionStream is missing). A newer one is needed.");
    const stream = new Blob([bytes]).stream().pipeThrough(new DecompressionStream("deflate"));
    return new Uint8Array(await new Response(stream).arrayBuffer());
}

const linearOf = new Float32Array(256);
for (let i = 0; i < 256; i++) linearOf[i] = i <= 10 ? i / 255 / 12.92 : Math.pow((i / 255 + 0.055) / 1.055, 2.4);
function srgbOf(v) {
    return Math.round(255 * (v <= 0.0031308 ? 12.92 * v : 1.055 * Math.pow(v, 1 / 2.4) - 0.055));
}

function decodeNormal(u, v, out) {
    let x = (u - 127) / 127, y = (v - 127) / 127;
    const z = 1 - Math.abs(x) - Math.abs(y);
    if (z < 0) [x, y] = [(1 - Math.abs(y)) * (x < 0 ? -1 : 1), (1 - Math.abs(x)) * (y < 0 ? -1 : 1)];
    const l = Math.hypot(x, y, z) || 1;
    out[0] = x / l, out[1] = y / l, out[2] = z / l;
}
function encodeNormal(x, y, z) {
    const s = Math.abs(x) + Math.abs(y) + Math.abs(z);
    if (!(s > 0)) return 127 | 127 << 8;
    x /= s, y /= s;
    if (z < 0) [x, y] = [(1 - Math.abs(y)) * (x < 0 ? -1 : 1), (1 - Math.abs(x)) * (y < 0 ? -1 : 1)];
    return Math.round(127 + 127 * x) | Math.round(127 + 127 * y) << 8;
}

const bits = new Uint8Array(256);
for (let i = 1; i < 256; i++) bits[i] = bits[i >> 1] + (i & 1);

/* Child masks level by level to words with the number of the first child; counts[level] nodes. */
function readTree(asset, bytes, at) {
    const inner = asset.inner, words = new Uint32Array(inner), counts = [asset.nodes === 0 ? 0 : 1];
    let child = counts[0], node = 0;
    for (let level = 0; level < asset.depth; level++) {
        const end = node + counts[level];
        counts.push(0);
        for (; node < end; node++) {
            const mask = bytes[at + node];
            words[node] = mask | child << 8;
            child += bits[mask];
            counts[level + 1] += bits[mask];
        }
    }
    if (node !== inner || child !== asset.nodes) problem("The data of this page are damaged.");
    return { words, counts };
}

/* Values of leaves to all nodes: an inner node has the average of the finest cells below it, a label that of its first leaf. */
function readAttributes(asset, tree, bytes, at, attributes, emissive, base) {
    const n = asset.nodes, leaves = asset.leaves, planes = {};
    for (const name of asset.planes) {
        const plane = bytes.subarray(at, at + leaves);
        for (let i = 1; i < leaves; i++) plane[i] = plane[i] + plane[i - 1] & 255;
        planes[name] = plane;
        at += leaves;
    }
    const value = (name, i) => planes[name] ? planes[name][i] : asset.constant[name] || 0;
    if (asset.unnumbered) {
        attributes[2 * base] = value("r", 0) | value("g", 0) << 8 | value("b", 0) << 16 | value("c", 0) << 24;
        attributes[2 * base + 1] = value("u", 0) | value("v", 0) << 8 | value("i", 0) << 16 | value("j", 0) << 24;
        if (emissive) emissive[base] = value("er", 0) | value("eg", 0) << 8 | value("eb", 0) << 16;
        return at;
    }
    const normal = planes.u !== undefined, glow = planes.er !== undefined, glass = planes.c !== undefined;
    const width = 3 + (normal ? 3 : 0) + (glass ? 1 : 0) + (glow ? 3 : 0), cover = normal ? 6 : 3, sums = new Float32Array(n * width), weight = new Float64Array(n), v = [0, 0, 0];
    let leaf = 0, node = 0;
    const levelEnd = [];
    for (let level = 0, end = 0; level <= asset.depth; level++) {
        end += tree.counts[level];
        levelEnd.push(end);
        for (; node < end; node++) {
            if (level < asset.depth && (tree.words[node] & 255) !== 0) continue;
            const w = weight[node] = Math.pow(8, asset.depth - level), s = node * width, to = 2 * (base + node);
            const r = value("r", leaf), g = value("g", leaf), b = value("b", leaf);
            attributes[to] = r | g << 8 | b << 16 | value("c", leaf) << 24;
            if (glass) sums[s + cover] = w * planes.c[leaf];
            attributes[to + 1] = value("u", leaf) | value("v", leaf) << 8 | value("i", leaf) << 16 | value("j", leaf) << 24;
            sums[s] = w * linearOf[r], sums[s + 1] = w * linearOf[g], sums[s + 2] = w * linearOf[b];
            if (normal) {
                decodeNormal(planes.u[leaf], planes.v[leaf], v);
                sums[s + 3] = w * v[0], sums[s + 4] = w * v[1], sums[s + 5] = w * v[2];
            }
            if (emissive) {
                const er = value("er", leaf), eg = value("eg", leaf), eb = value("eb", leaf);
                emissive[base + node] = er | eg << 8 | eb << 16;
                if (glow) sums[s + width - 3] = w * linearOf[er], sums[s + width - 2] = w * linearOf[eg], sums[s + width - 1] = w * linearOf[eb];
            }
            leaf++;
        }
    }
    if (leaf !== leaves) problem("The data of this page are damaged.");
    for (let i = asset.inner - 1; i >= 0; i--) {
        const mask = tree.words[i] & 255, first = tree.words[i] >>> 8, s = i * width, to = 2 * (base + i);
        if (mask === 0) continue;
        for (let c = first; c < first + bits[mask]; c++) {
            weight[i] += weight[c];
            for (let k = 0; k < width; k++) sums[s + k] += sums[c * width + k];
        }
        const w = weight[i];
        attributes[to] = srgbOf(sums[s] / w) | srgbOf(sums[s + 1] / w) << 8 | srgbOf(sums[s + 2] / w) << 16 | (glass ? Math.round(sums[s + cover] / w) : value("c", 0)) << 24;
        const uv = normal ? encodeNormal(sums[s + 3], sums[s + 4], sums[s + 5]) : value("u", 0) | value("v", 0) << 8;
        attributes[to + 1] = uv | attributes[2 * (base + first) + 1] & 0xffff0000;
        if (glow) emissive[base + i] = srgbOf(sums[s + width - 3] / w) | srgbOf(sums[s + width - 2] / w) << 8 | srgbOf(sums[s + width - 1] / w) << 16;
        else if (emissive) emissive[base + i] = emissive[base + first];
    }
    return at;
}

/* ---- instances ----------------------------------------------------------------------------------------------------- */

/* Inverse of a 3x4 affine matrix, null where there is none. */
function invert(m) {
    const c = [m[5] * m[10] - m[6] * m[9], m[2] * m[9] - m[1] * m[10], m[1] * m[6] - m[2] * m[5], m[6] * m[8] - m[4] * m[10], m[0] * m[10] - m[2] * m[8],
               m[2] * m[4] - m[0] * m[6], m[4] * m[9] - m[5] * m[8], m[1] * m[8] - m[0] * m[9], m[0] * m[5] - m[1] * m[4]];
    const det = m[0] * c[0] + m[1] * c[3] + m[2] * c[6];
    if (!(Math.abs(det) > 0) || !isFinite(1 / det)) return null;
    const r = new Float64Array(12);
    for (let i = 0; i < 3; i++) {
        for (let k = 0; k < 3; k++) r[4 * i + k] = c[3 * i + k] / det;
        r[4 * i + 3] = -(r[4 * i] * m[3] + r[4 * i + 1] * m[7] + r[4 * i + 2] * m[11]);
    }
    return r;
}

/* Box of the part of the cube that has voxels. */
function boxOf(m, asset) {
    const low = [0, 0, 0], high = [0, 0, 0];
    for (let i = 0; i < 3; i++) {
        low[i] = high[i] = m[4 * i + 3];
        for (let k = 0; k < 3; k++) {
            const a = m[4 * i + k] * asset.low[k], b = m[4 * i + k] * asset.high[k];
            low[i] += Math.min(a, b), high[i] += Math.max(a, b);
        }
        const room = 1e-6 * Math.max(Math.abs(low[i]), Math.abs(high[i]), high[i] - low[i]);
        low[i] -= room, high[i] += room;
    }
    return { low, high };
}

/* Median splits along the longest side. Reorders `list`; returns the rows of uTree. */
function buildHierarchy(list) {
    const rows = [];
    const add = (begin, end) => {
        const at = rows.length / 8, low = [Infinity, Infinity, Infinity], high = [-Infinity, -Infinity, -Infinity];
        for (let i = begin; i < end; i++)
            for (let k = 0; k < 3; k++) low[k] = Math.min(low[k], list[i].box.low[k]), high[k] = Math.max(high[k], list[i].box.high[k]);
        rows.push(...low, begin, ...high, end - begin);
        if (end - begin <= 2) return at;
        let axis = 0;
        for (let k = 1; k < 3; k++) if (high[k] - low[k] > high[axis] - low[axis]) axis = k;
        const part = list.slice(begin, end).sort((a, b) => a.box.low[axis] + a.box.high[axis] - b.box.low[axis] - b.box.high[axis] || a.number - b.number);
        for (let i = 0; i < part.length; i++) list[begin + i] = part[i];
        const middle = begin + end >> 1, left = add(begin, middle), right = add(middle, end);
        rows[8 * at + 3] = left, rows[8 * at + 7] = -right;
        return at;
    };
    add(0, list.length);
    return rows;
}

/* ---- WebGL --------------------------------------------------------------------------------------------------------- */

const gl = canvas.getContext("webgl2", { antialias: false, preserveDrawingBuffer: true, alpha: false });
if (!gl) problem("This page needs WebGL 2, which this browser does not offer.");

function program(defines) {
    const vertex = "#version 300 es\nvoid main() { gl_Position = vec4(gl_VertexID == 1 ? 3.0 : -1.0, gl_VertexID == 2 ? 3.0 : -1.0, 0.0, 1.0); }";
    const p = gl.createProgram();
    for (const [kind, text] of [[gl.VERTEX_SHADER, vertex], [gl.FRAGMENT_SHADER, "#version 300 es\n" + defines + element("shader").textContent]]) {
        const s = gl.createShader(kind);
        gl.shaderSource(s, text);
        gl.compileShader(s);
        if (!gl.getShaderParameter(s, gl.COMPILE_STATUS)) problem("The shader was refused: " + gl.getShaderInfoLog(s));
        gl.attachShader(p, s);
    }
    gl.linkProgram(p);
    if (!gl.getProgramParameter(p, gl.LINK_STATUS)) problem("The shader was refused: " + gl.getProgramInfoLog(p));
    const at = {};
    for (let i = 0; i < gl.getProgramParameter(p, gl.ACTIVE_UNIFORMS); i++) {
        const name = gl.getActiveUniform(p, i).name;
        at[name] = gl.getUniformLocation(p, name);
    }
    return { p, at };
}

const formats = { r32ui: [gl.R32UI, gl.RED_INTEGER, gl.UNSIGNED_INT, 1], rg32ui: [gl.RG32UI, gl.RG_INTEGER, gl.UNSIGNED_INT, 2],
                  rgba32ui: [gl.RGBA32UI, gl.RGBA_INTEGER, gl.UNSIGNED_INT, 4], rgba32f: [gl.RGBA32F, gl.RGBA, gl.FLOAT, 4] };
function texture(unit, format, array) {
    const [internal, external, type, width] = formats[format], texels = Math.max(1, array.length / width), rows = Math.ceil(texels / WIDTH);
    if (rows > gl.getParameter(gl.MAX_TEXTURE_SIZE)) problem("The octree is too large for the textures of this device; make the page smaller with --html-size.");
    let data = array;
    if (array.length !== rows * WIDTH * width) {
        data = new array.constructor(rows * WIDTH * width);
        data.set(array);
    }
    gl.activeTexture(gl.TEXTURE0 + unit);
    gl.bindTexture(gl.TEXTURE_2D, gl.createTexture());
    gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_MIN_FILTER, gl.NEAREST);
    gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_MAG_FILTER, gl.NEAREST);
    gl.texImage2D(gl.TEXTURE_2D, 0, internal, WIDTH, rows, 0, external, type, data);
}

/* ---- loading ------------------------------------------------------------------------------------------------------- */

const bytes = await unpack();
const begins = [];
let words = 0, values = 0, deepest = 0, anyEmissive = false, labels = false, seeThrough = false;
for (const a of meta.assets) {
    words += a.inner;
    values += a.unnumbered ? 1 : a.nodes;
    deepest = Math.max(deepest, a.depth);
    anyEmissive = anyEmissive || a.emissive;
    labels = labels || a.label !== null;
    seeThrough = seeThrough || a.coverage;
}
const nodeWords = new Uint32Array(Math.max(1, words)), attributeWords = new Uint32Array(2 * Math.max(1, values));
const emissiveWords = anyEmissive ? new Uint32Array(Math.max(1, values)) : null, assetWords = new Uint32Array(8 * Math.max(1, meta.assets.length));
{
    let at = 0, word = 0, value = 0;
    meta.assets.forEach((a, i) => {
        const tree = readTree(a, bytes, at);
        at = readAttributes(a, tree, bytes, at + a.inner, attributeWords, emissiveWords, value);
        nodeWords.set(tree.words, word);
        begins.push({ node: word, value });
        assetWords.set([word, value, a.depth, (a.normal ? 1 : 0) | (a.unnumbered ? 2 : 0) | (a.emissive ? 4 : 0) | (a.thin ? 8 : 0)], 8 * i);
        word += a.inner, value += a.unnumbered ? 1 : a.nodes;
    });
    if (at + 52 * meta.instance_count !== bytes.length) problem("The data of this page are damaged.");
}
const instances = [];
{
    const view = new DataView(bytes.buffer, bytes.byteOffset + bytes.length - 52 * meta.instance_count);
    for (let i = 0; i < meta.instance_count; i++) {
        const m = [];
        for (let k = 0; k < 12; k++) m.push(view.getFloat32(52 * i + 4 + 4 * k, true));
        const inverse = invert(m), asset = view.getUint32(52 * i, true);
        if (inverse !== null) instances.push({ number: i, asset, m, inverse, box: boxOf(m, meta.assets[asset]) });
    }
}
const tree = instances.length > 0 ? buildHierarchy(instances) : [1, 1, 1, 0, -1, -1, -1, 0.5];
const instanceRows = new Float32Array(28 * Math.max(1, instances.length));
const bounds = { low: [Infinity, Infinity, Infinity], high: [-Infinity, -Infinity, -Infinity] };
instances.forEach((o, i) => {
    let edge = 0;
    for (let k = 0; k < 3; k++) {
        edge = Math.max(edge, Math.hypot(o.m[k], o.m[4 + k], o.m[8 + k]));
        bounds.low[k] = Math.min(bounds.low[k], o.box.low[k]), bounds.high[k] = Math.max(bounds.high[k], o.box.high[k]);
    }
    instanceRows.set(o.inverse, 28 * i);
    instanceRows.set(o.m, 28 * i + 12);
    instanceRows.set([o.asset, edge, o.number], 28 * i + 24);
});
if (instances.length === 0) bounds.low = [0, 0, 0], bounds.high = [1, 1, 1];

texture(0, "r32ui", nodeWords);
texture(1, "rg32ui", attributeWords);
texture(2, "r32ui", emissiveWords || new Uint32Array(1));
texture(3, "rgba32ui", assetWords);
texture(4, "rgba32f", instanceRows);
texture(5, "rgba32f", new Float32Array(tree));
const drawing = program(seeThrough ? "#define SEE_THROUGH\n" : ""), picking = program("#define PICK\n");
const pickTarget = gl.createFramebuffer();
{
    gl.activeTexture(gl.TEXTURE6);
    const t = gl.createTexture();
    gl.bindTexture(gl.TEXTURE_2D, t);
    gl.texStorage2D(gl.TEXTURE_2D, 1, gl.RGBA32UI, 1, 1);
    gl.bindFramebuffer(gl.FRAMEBUFFER, pickTarget);
    gl.framebufferTexture2D(gl.FRAMEBUFFER, gl.COLOR_ATTACHMENT0, gl.TEXTURE_2D, t, 0);
    gl.bindFramebuffer(gl.FRAMEBUFFER, null);
}
gl.bindVertexArray(gl.createVertexArray());

/* ---- camera: scene coordinates relative to meta.origin --------------------------------------------------------------- */

const sub = (a, b) => [a[0] - b[0], a[1] - b[1], a[2] - b[2]], add = (a, b, s = 1) => [a[0] + s * b[0], a[1] + s * b[1], a[2] + s * b[2]];
const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2], length = a => Math.hypot(a[0], a[1], a[2]);
const cross = (a, b) => [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
const unit = a => { const l = length(a) || 1; return [a[0] / l, a[1] / l, a[2] / l]; };

const camera = { eye: [0, 0, 1], target: [0, 0, 0], fov: 40 };
function axes() {
    const forward = unit(sub(camera.target, camera.eye));
    let right = cross(forward, [0, 1, 0]);
    if (length(right) < 1e-6) right = cross(forward, [0, 0, 1]);
    right = unit(right);
    return { forward, right, up: cross(right, forward) };
}

/* Middle of the part of the canvas that the panel leaves free, in CSS pixels. A panel over most of a narrow window moves nothing:
 * what it leaves would be too little to look at, and who has it open there reads it. */
function center() {
    const width = canvas.clientWidth, p = element("panel"), open = !p.hidden && !p.classList.contains("folded");
    return open && p.offsetLeft > 0.4 * width ? 0.5 * p.offsetLeft : 0.5 * width;
}

function frame() {
    const forward = unit([-0.62, -0.42, -1]), right = unit(cross(forward, [0, 1, 0])), up = cross(right, forward);
    const middle = bounds.low.map((v, k) => 0.5 * (v + bounds.high[k])), ty = Math.tan(camera.fov * Math.PI / 360) * 0.92;
    const tx = ty * Math.max(0.2, 2 * center() / Math.max(1, canvas.clientHeight));
    let distance = 1e-6;
    for (let i = 0; i < 8; i++) {
        const c = sub([0, 1, 2].map(k => i >> k & 1 ? bounds.high[k] : bounds.low[k]), middle), z = dot(c, forward);
        distance = Math.max(distance, Math.abs(dot(c, right)) / tx - z, Math.abs(dot(c, up)) / ty - z);
    }
    camera.target = middle;
    camera.eye = add(middle, forward, -distance);
    redraw();
}

function turn(dx, dy) {
    const offset = sub(camera.eye, camera.target), r = length(offset);
    let yaw = Math.atan2(offset[0], offset[2]) - dx, pitch = Math.asin(Math.max(-1, Math.min(1, offset[1] / r))) + dy;
    pitch = Math.max(-1.55, Math.min(1.55, pitch));
    camera.eye = add(camera.target, [r * Math.cos(pitch) * Math.sin(yaw), r * Math.sin(pitch), r * Math.cos(pitch) * Math.cos(yaw)]);
    redraw();
}

function shift(dx, dy) { // in pixels; what is at the target's distance follows the pointer
    const a = axes(), scale = 2 * Math.tan(camera.fov * Math.PI / 360) * length(sub(camera.eye, camera.target)) / canvas.clientHeight;
    const by = add(a.right.map(v => -v * dx * scale), a.up, dy * scale);
    camera.eye = add(camera.eye, by), camera.target = add(camera.target, by);
    redraw();
}

function rayAt(x, y) { // of a place in the canvas, in CSS pixels
    const a = axes(), s = 2 * Math.tan(camera.fov * Math.PI / 360) / canvas.clientHeight;
    return add(add(a.forward, a.right, (x - center()) * s), a.up, (0.5 * canvas.clientHeight - y) * s);
}

/* Move towards what is under the pointer, so that it stays there. */
function zoom(x, y, factor) {
    const hit = pick(x, y), ray = rayAt(x, y), distance = length(sub(camera.eye, camera.target));
    const size = Math.max(...bounds.high.map((v, k) => v - bounds.low[k]));
    const t = hit ? hit.t : distance, least = 1e-5 * size;
    if (factor < 1 && t * factor < least) return;
    const to = add(camera.eye, ray, t), eye = add(to, sub(camera.eye, to), factor), a = axes();
    camera.target = add(eye, a.forward, Math.max(least, distance * factor));
    camera.eye = eye;
    redraw();
}

/* ---- drawing ------------------------------------------------------------------------------------------------------- */

const state = { mode: 0, level: deepest, axis: -1, slice: 0.5, flip: false, shadows: true, detail: true, steady: false }; // steady: never coarser while moving
let scale = 1, wanted = false, cost = 0, moving = 0;

function useProgram(which, width, height, middle, dx, dy) {
    gl.useProgram(which.p);
    const a = axes(), at = which.at, names = ["uNodes", "uAttributes", "uEmissive", "uAssets", "uInstances", "uTree"];
    names.forEach((name, i) => { if (at[name]) gl.uniform1i(at[name], i); });
    gl.uniform3fv(at.uEye, camera.eye);
    gl.uniform3fv(at.uRight, a.right);
    gl.uniform3fv(at.uUp, a.up);
    gl.uniform3fv(at.uForward, a.forward);
    gl.uniform2f(at.uSize, width, height);
    gl.uniform2f(at.uOffset, dx, dy);
    gl.uniform1f(at.uCenter, middle);
    gl.uniform1f(at.uHalf, Math.tan(camera.fov * Math.PI / 360));
    gl.uniform1f(at.uFootprint, state.detail ? 1 : 0);
    gl.uniform1i(at.uLevel, state.level);
    const n = [0, 0, 0];
    let w = 0;
    if (state.axis >= 0) {
        const s = state.flip ? -1 : 1;
        n[state.axis] = s;
        w = s * (bounds.low[state.axis] + state.slice * (bounds.high[state.axis] - bounds.low[state.axis]));
    }
    gl.uniform4f(at.uSlice, n[0], n[1], n[2], w);
    if (which === picking) return;
    gl.uniform1i(at.uMode, state.mode);
    gl.uniform1i(at.uShadows, state.shadows ? 1 : 0);
    gl.uniform3fv(at.uLight, unit([-0.45, 0.85, 0.65]));
    gl.uniform1f(at.uAmbient, 0.35);
    gl.uniform3f(at.uTop, 0.50, 0.58, 0.68);
    gl.uniform3f(at.uBottom, 0.86, 0.87, 0.88);
}

function draw(factor = 1, middle = center()) {
    const ratio = (window.devicePixelRatio || 1) * factor;
    const width = Math.max(1, Math.round(canvas.clientWidth * ratio)), height = Math.max(1, Math.round(canvas.clientHeight * ratio));
    if (canvas.width !== width || canvas.height !== height) canvas.width = width, canvas.height = height;
    const begin = performance.now();
    gl.bindFramebuffer(gl.FRAMEBUFFER, null);
    gl.viewport(0, 0, width, height);
    useProgram(drawing, width, height, middle * width / Math.max(1, canvas.clientWidth), 0, 0);
    gl.drawArrays(gl.TRIANGLES, 0, 3);
    gl.readPixels(0, 0, 1, 1, gl.RGBA, gl.UNSIGNED_BYTE, new Uint8Array(4)); // wait for it
    cost = performance.now() - begin;
    element("timing").textContent = width + " x " + height + " in " + cost.toFixed(1) + " ms";
    return cost;
}

/* While the view moves the picture may be coarser; it becomes sharp when it rests. */
function redraw() {
    moving = performance.now();
    if (wanted) return;
    wanted = true;
    requestAnimationFrame(() => {
        wanted = false;
        draw(state.steady ? 1 : scale);
        if (cost > 50 && scale > 0.2) scale *= 0.7;
        else if (cost < 12 && scale < 1) scale = Math.min(1, scale * 1.3);
        setTimeout(() => { if (performance.now() - moving > 180 && !wanted) { draw(1); remember(); } }, 200);
    });
}

const floats = new Float32Array(1), words32 = new Uint32Array(floats.buffer);
/* What is at a place of the canvas (CSS pixels): null, or {t, position, instance, level, color, label}. */
function pick(x, y) {
    const width = Math.max(1, canvas.clientWidth), height = Math.max(1, canvas.clientHeight), out = new Uint32Array(4);
    gl.bindFramebuffer(gl.FRAMEBUFFER, pickTarget);
    gl.viewport(0, 0, 1, 1);
    useProgram(picking, width, height, center(), x - 0.5, height - y - 0.5);
    gl.drawArrays(gl.TRIANGLES, 0, 3);
    gl.readPixels(0, 0, 1, 1, gl.RGBA_INTEGER, gl.UNSIGNED_INT, out);
    gl.bindFramebuffer(gl.FRAMEBUFFER, null);
    words32[0] = out[0];
    const t = floats[0];
    if (!(t >= 0) || (out[1] & 0xffffff) === 0) return null;
    const o = instances[(out[1] & 0xffffff) - 1], level = out[1] >>> 24, a = meta.assets[o.asset];
    const cell = [out[2] & 0x1fffff, out[2] >>> 21 | (out[3] & 0x3ff) << 11, out[3] >>> 10];
    let node = 0;
    for (let l = level - 1; l >= 0; l--) {
        const bit = (cell[0] >> l & 1) | (cell[1] >> l & 1) << 1 | (cell[2] >> l & 1) << 2, word = nodeWords[begins[o.asset].node + node];
        node = (word >>> 8) + bits[word & (1 << bit) - 1 & 255];
    }
    const at = 2 * (begins[o.asset].value + (a.unnumbered ? 0 : node)), color = attributeWords[at];
    return { t, position: add(add(camera.eye, rayAt(x, y), t), meta.origin), instance: o.number, asset: o.asset, level, cell,
             color: [color & 255, color >>> 8 & 255, color >>> 16 & 255], label: attributeWords[at + 1] >>> 16 };
}

/* ---- the panel ----------------------------------------------------------------------------------------------------- */

const number = v => typeof v !== "number" ? String(v) : Number.isInteger(v) ? v.toLocaleString("en-US") : String(+v.toPrecision(5));
function table(title, rows) {
    if (rows.length === 0) return;
    const h = document.createElement("h2"), t = document.createElement("table");
    h.textContent = title;
    for (const row of rows) {
        const r = t.insertRow();
        row.forEach(v => {
            const c = r.insertCell();
            c.textContent = number(v);
            if (typeof v === "number") c.className = "n";
            else if (c.cellIndex === 0 && c.textContent.length <= 16) c.className = "name";
        });
    }
    element("facts").append(h, t);
}

function panel() {
    const s = meta.summary, name = String(s.file).split("/").pop();
    document.title = element("name").textContent = name;
    const rows = [["format", s.format], ["bytes", s.bytes], ["voxels", s.voxels], ["nodes", s.nodes], ["depth", s.depth]];
    if (s.bytes_per_voxel) rows.push(["bytes a voxel", s.bytes_per_voxel]);
    if (meta.instance_count > 1) rows.push(["instances", meta.instance_count], ["assets", meta.assets.length]);
    if (meta.dropped_levels > 0) rows.push(["shown", "to level " + deepest + " of " + (deepest + meta.dropped_levels) + ", " + meta.dropped_levels + " finest left out: too much for a page"]);
    if (meta.rested > 0) rows.push(["poses", "not drawn: " + meta.rested + (meta.rested === 1 ? " instance is" : " instances are") + " shown without pose"]);
    table("File", rows);
    table("Attributes", (s.attributes || []).map(a => [a.name, a.encoding || a.kind || "", a.bytes !== undefined ? a.bytes : ""]));
    table("Levels", (s.levels || []).map(l => [l.level, l.nodes].concat(l.stored !== undefined ? [l.stored] : [])));
    table("Sections", (s.sections || []).map(x => [x.type, x.bytes]));
    if (meta.assets.length > 1) table("Assets", meta.assets.slice(0, 200).map(a => [a.name || "(no name)", a.nodes]));
    if (s.provenance) {
        const p = s.provenance, more = [["tool", (p.tool || "") + " " + (p.version || "")]];
        for (const [k, v] of Object.entries(p.options || {})) if (v !== null) more.push([k, typeof v === "object" ? JSON.stringify(v) : String(v)]);
        table("Made by", more);
    }
    const modes = [[0, "colour"], [5, "colour without light"], [1, "normal"], [2, "level"], [3, "instance"]];
    if (labels) modes.push([4, meta.assets.find(a => a.label !== null).label]);
    for (const [value, text] of modes) element("mode").add(new Option(text, value));
}

function syncControls() {
    element("mode").value = state.mode;
    element("level").max = deepest;
    element("level").value = state.level;
    element("level-text").textContent = state.level;
    element("axis").value = state.axis;
    element("slice").value = 1000 * state.slice;
    element("flip").checked = state.flip;
    element("shadows").checked = state.shadows;
    element("detail").checked = state.detail;
}

function control(id, read) {
    element(id).addEventListener("input", () => {
        read(element(id));
        syncControls();
        redraw();
    });
}
control("mode", e => state.mode = +e.value);
control("level", e => state.level = +e.value);
control("axis", e => state.axis = +e.value);
control("slice", e => state.slice = e.value / 1000);
control("flip", e => state.flip = e.checked);
control("shadows", e => state.shadows = e.checked);
control("detail", e => state.detail = e.checked);
element("frame").onclick = frame;
element("save").onclick = save;
element("fold").onclick = fold;

function fold() {
    element("panel").classList.toggle("folded");
    redraw();
}

function save() {
    draw(1, 0.5 * canvas.clientWidth); // a picture has no panel to make room for
    const a = document.createElement("a");
    a.download = element("name").textContent + ".png";
    a.href = canvas.toDataURL("image/png");
    a.click();
    redraw();
}

let shownAt = 0;
function showPicked(x, y) {
    if (performance.now() - shownAt < 100) return;
    shownAt = performance.now();
    const h = pick(x, y);
    if (!h) {
        element("picked").textContent = "nothing";
        return;
    }
    const named = meta.instance_names[h.instance] || "", lines = ["cell " + h.cell.join(" ") + " of level " + h.level, "at " + h.position.map(v => +v.toPrecision(6)).join(" "),
        "colour " + h.color.join(" ")];
    if (meta.instance_count > 1) lines.push("instance " + h.instance + (named ? " " + named : "") + ", asset " + (meta.assets[h.asset].name || h.asset));
    if (meta.assets[h.asset].label) lines.push(meta.assets[h.asset].label + " " + h.label);
    element("picked").textContent = lines.join("\n");
    element("picked").style.whiteSpace = "pre-wrap";
}

/* ---- pointer and keys ------------------------------------------------------------------------------------------------ */

const pointers = new Map();
canvas.addEventListener("contextmenu", e => e.preventDefault());
canvas.addEventListener("pointerdown", e => {
    canvas.focus();
    canvas.setPointerCapture(e.pointerId);
    pointers.set(e.pointerId, { x: e.clientX, y: e.clientY, pan: e.button !== 0 || e.shiftKey });
    canvas.classList.add("moving");
});
canvas.addEventListener("pointermove", e => {
    const p = pointers.get(e.pointerId);
    if (!p) {
        showPicked(e.clientX, e.clientY);
        return;
    }
    const dx = e.clientX - p.x, dy = e.clientY - p.y;
    if (pointers.size === 2) { // two fingers: move and zoom
        const other = [...pointers].find(([id]) => id !== e.pointerId)[1];
        const before = Math.hypot(p.x - other.x, p.y - other.y), now = Math.hypot(e.clientX - other.x, e.clientY - other.y);
        shift(dx / 2, dy / 2);
        if (before > 0 && now > 0) zoom((e.clientX + other.x) / 2, (e.clientY + other.y) / 2, before / now);
    } else if (p.pan) {
        shift(dx, dy);
    } else {
        turn(dx * 0.008, dy * 0.008);
    }
    p.x = e.clientX, p.y = e.clientY;
});
for (const kind of ["pointerup", "pointercancel"])
    canvas.addEventListener(kind, e => {
        pointers.delete(e.pointerId);
        if (pointers.size === 0) canvas.classList.remove("moving");
    });
canvas.addEventListener("wheel", e => {
    e.preventDefault();
    const lines = e.deltaMode === 1 ? 33 : e.deltaMode === 2 ? 400 : 1;
    zoom(e.clientX, e.clientY, Math.exp(Math.max(-1, Math.min(1, e.deltaY * lines * 0.0015))));
}, { passive: false });
canvas.addEventListener("dblclick", e => {
    const h = pick(e.clientX, e.clientY);
    if (!h) return;
    const to = sub(h.position, meta.origin), by = sub(to, camera.target);
    camera.target = to, camera.eye = add(camera.eye, by);
    redraw();
});
window.addEventListener("keydown", e => {
    if (e.target instanceof HTMLInputElement || e.target instanceof HTMLSelectElement || e.ctrlKey || e.metaKey || e.altKey) return;
    const step = 0.1, w = center(), h = canvas.clientHeight / 2;
    const keys = { ArrowLeft: () => turn(-step, 0), ArrowRight: () => turn(step, 0), ArrowUp: () => turn(0, step), ArrowDown: () => turn(0, -step),
        "+": () => zoom(w, h, 0.85), "=": () => zoom(w, h, 0.85), "-": () => zoom(w, h, 1 / 0.85), f: frame, Home: frame, s: save,
        h: fold };
    const act = keys[e.key.length === 1 ? e.key.toLowerCase() : e.key];
    if (!act) return;
    e.preventDefault();
    act();
});
new ResizeObserver(redraw).observe(canvas);

/* The camera is in the address, so that a view can be kept and shared. */
function remember() {
    const text = v => v.map(x => +x.toPrecision(9)).join(",");
    const hash = "#eye=" + text(add(camera.eye, meta.origin)) + "&target=" + text(add(camera.target, meta.origin)) + "&fov=" + camera.fov;
    try { history.replaceState(null, "", hash); } catch (e) { /* not allowed everywhere */ }
}
function setCamera(eye, target, fov) {
    camera.eye = sub(eye, meta.origin), camera.target = sub(target, meta.origin);
    if (fov) camera.fov = Math.max(1, Math.min(170, fov));
    redraw();
}
function recall() {
    const words = new URLSearchParams(location.hash.slice(1)), vec = n => (words.get(n) || "").split(",").map(Number);
    const eye = vec("eye"), target = vec("target");
    if (eye.length !== 3 || target.length !== 3 || ![...eye, ...target].every(isFinite) || length(sub(eye, target)) === 0) return false;
    setCamera(eye, target, +words.get("fov") || 0);
    return true;
}
window.addEventListener("hashchange", recall);

panel();
syncControls();
if (innerWidth < 640) element("panel").classList.add("folded");
if (!recall()) {
    frame();
    if (meta.camera) setCamera(meta.camera.eye, meta.camera.target, meta.camera.fov);
}
window.svokit = { meta, state, camera, setCamera, frame, draw, pick, redraw: () => { syncControls(); redraw(); },
                  view: () => ({ eye: add(camera.eye, meta.origin), target: add(camera.target, meta.origin), fov: camera.fov }), ready: true };
document.body.dataset.ready = "yes";
})();
