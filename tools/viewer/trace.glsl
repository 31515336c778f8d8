// Ray-casts sparse octrees that lie in textures. One source, two programs: with PICK defined it writes what is under one
// pixel as integers, otherwise it writes the picture; with SEE_THROUGH defined some nodes cover a part only of what is behind them.
//
// uNodes: one word a node above the leaves: bits 0..7 child mask (0: all of the node is full), bits 8..31 number of
// the first child within its octree. Children are stored together, so child k of a node is first + (bits of the mask below k).
// uAttributes: two words a node: sRGB colour in three bytes, coverage in one; octahedral normal in two bytes (127 is zero), label in 16 bits.
// uAssets: two texels an octree: begin in uNodes, begin in uAttributes, depth, flags.
// uInstances: seven texels an instance: rows of scene-to-cube (the octree is the unit cube), rows of cube-to-scene, then
// number of the octree, longest edge of the cube in the scene, number of the instance in the file.
// uTree: bounding volumes of instances, two texels each: low corner and left child or first instance; high corner and
// minus the right child, or the number of instances.
precision highp float;
precision highp int;
precision highp sampler2D;
precision highp usampler2D;

uniform usampler2D uNodes, uAttributes, uEmissive, uAssets;
uniform sampler2D uInstances, uTree;
uniform vec3 uEye, uRight, uUp, uForward; // of length 1
uniform vec2 uSize;                       // of the picture in pixels
uniform vec2 uOffset;                     // of this drawing in the picture
uniform float uCenter;                    // column that the camera looks along: the middle of what the panel leaves free
uniform float uHalf;                      // tangent of half the vertical field of view
uniform float uFootprint;                 // stop at nodes so many pixels wide; 0: at leaves only
uniform int uLevel;                       // finest level drawn
uniform vec4 uSlice;                      // points with dot(xyz, p) > w are cut away; xyz = 0: nothing is
uniform int uMode;                        // 0 colour, 1 normal, 2 level, 3 instance, 4 label, 5 colour without light
uniform int uShadows;
uniform vec3 uLight;
uniform float uAmbient;
uniform vec3 uTop, uBottom;               // background, linear light

const int WIDTH = 4096;
const int STACK = 32;
const uint HAS_NORMAL = 1u, UNNUMBERED = 2u, HAS_EMISSIVE = 4u, THIN = 8u;
const int LAYERS = 64; // that a ray goes through at most

struct Hit {
    float t;       // along the ray, negative: nothing
    int instance, level, axis; // axis of the face the ray came through, -1: none (it began inside), 3: the slice plane
    uint node;     // within its octree
    ivec3 cell;    // at its level
};

ivec2 place(int i) { return ivec2(i & (WIDTH - 1), i >> 12); }
uint node_word(uint i) { return texelFetch(uNodes, ivec2(int(i & 4095u), int(i >> 12)), 0).r; }

uint count_bits(uint v)
{
    v = v - ((v >> 1) & 0x55u);
    v = (v & 0x33u) + ((v >> 2) & 0x33u);
    return (v + (v >> 4)) & 0xfu;
}

// A direction without zeros: the planes of an axis along which the ray does not move are never reached.
vec3 safe(vec3 d)
{
    float least = 1e-9 * max(max(abs(d.x), abs(d.y)), abs(d.z));
    return vec3(abs(d.x) < least ? least : d.x, abs(d.y) < least ? least : d.y, abs(d.z) < least ? least : d.z);
}

// Where the ray begins: nothing, or the face through which it left the last node.
int begin_axis = -1;

// One octree. o + t d is the ray in its cells (0 .. 2^depth). A node is small enough when edge * 2^-level <= spread t + offset.
void trace_tree(uint begin, int depth, vec3 o, vec3 d, float low, bool sliced, float edge, float spread, float offset, int instance, inout Hit best)
{
    float size = float(1 << depth);
    d = safe(d);
    vec3 inverse = 1.0 / d, a = -o * inverse, b = (vec3(size) - o) * inverse;
    vec3 near = min(a, b), far = max(a, b);
    float t = max(max(near.x, near.y), near.z), end = min(min(far.x, far.y), far.z);
    int axis = near.x >= near.y && near.x >= near.z ? 0 : near.y >= near.z ? 1 : 2;
    bool outside = t >= low;
    if (!outside) {
        t = low;
        axis = sliced ? 3 : begin_axis;
    }
    if (best.t >= 0.0) end = min(end, best.t);
    if (!(t < end)) return;
    bvec3 up = greaterThan(d, vec3(0.0));
    int most = min(depth, uLevel);
    ivec3 cell = clamp(ivec3(floor(o + d * t)), ivec3(0), ivec3((1 << depth) - 1));
    if (outside) cell[axis] = up[axis] ? 0 : (1 << depth) - 1;
    uint stack[22];
    stack[0] = 0u;
    int level = 0;
    for (int step = 0; step < 8192; step++) {
        uint node = stack[level], word = 0u;
        bool stop = level >= most || edge * exp2(-float(level)) <= spread * t + offset;
        if (!stop) {
            word = node_word(begin + node);
            stop = (word & 255u) == 0u;
        }
        if (stop) {
            best.t = t;
            best.instance = instance;
            best.level = level;
            best.axis = axis;
            best.node = node;
            best.cell = cell >> (depth - level);
            return;
        }
        int shift = depth - level - 1;
        ivec3 side = (cell >> shift) & 1;
        uint bit = uint(side.x + 2 * side.y + 4 * side.z);
        if ((word >> bit & 1u) != 0u) {
            level++;
            stack[level] = (word >> 8) + count_bits(word & ((1u << bit) - 1u));
            continue;
        }
        // an empty octant: leave it
        ivec3 corner = (cell >> shift) << shift;
        vec3 leave = (vec3(corner + ivec3(up) * (1 << shift)) - o) * inverse;
        axis = leave.x <= leave.y && leave.x <= leave.z ? 0 : leave.y <= leave.z ? 1 : 2;
        t = max(t, leave[axis]);
        if (!(t < end)) return;
        ivec3 next = clamp(ivec3(floor(o + d * t)), corner, corner + (1 << shift) - 1);
        next[axis] = up[axis] ? corner[axis] + (1 << shift) : corner[axis] - 1;
        if (next[axis] < 0 || next[axis] >= 1 << depth) return;
        int changed = (next.x ^ cell.x) | (next.y ^ cell.y) | (next.z ^ cell.z);
        int high = (floatBitsToInt(float(changed)) >> 23) - 127;
        level = min(level, depth - 1 - high);
        cell = next;
    }
}

void trace_instance(int i, vec3 origin, vec3 direction, float low, bool sliced, float spread, float offset, inout Hit best)
{
    int at = 7 * i;
    vec4 x = texelFetch(uInstances, place(at), 0), y = texelFetch(uInstances, place(at + 1), 0), z = texelFetch(uInstances, place(at + 2), 0);
    vec4 more = texelFetch(uInstances, place(at + 6), 0);
    uvec4 asset = texelFetch(uAssets, place(2 * int(more.x)), 0);
    int depth = int(asset.z);
    float size = float(1 << depth);
    vec3 o = vec3(dot(x.xyz, origin) + x.w, dot(y.xyz, origin) + y.w, dot(z.xyz, origin) + z.w) * size;
    vec3 d = vec3(dot(x.xyz, direction), dot(y.xyz, direction), dot(z.xyz, direction)) * size;
    trace_tree(asset.x, depth, o, d, low, sliced, more.y, spread, offset, i, best);
}

bool meets_box(vec3 low, vec3 high, vec3 o, vec3 inverse, float begin, float end)
{
    vec3 a = (low - o) * inverse, b = (high - o) * inverse, near = min(a, b), far = max(a, b);
    return max(max(near.x, near.y), max(near.z, begin)) <= min(min(far.x, far.y), min(far.z, end));
}

// From t = begin on.
Hit trace(vec3 origin, vec3 direction, float begin, float spread, float offset, bool any)
{
    Hit best = Hit(-1.0, -1, 0, -1, 0u, ivec3(0));
    float low = 0.0, high = 1e30;
    bool sliced = false;
    float along = dot(uSlice.xyz, direction), ahead = uSlice.w - dot(uSlice.xyz, origin);
    if (along > 0.0) high = ahead / along;
    else if (along < 0.0 && ahead < 0.0) low = ahead / along, sliced = true;
    else if (ahead < 0.0) return best;
    if (begin > low) low = begin, sliced = false;
    if (high <= low) return best;
    vec3 inverse = 1.0 / safe(direction);
    int stack[STACK];
    int top = 0;
    stack[top++] = 0;
    while (top > 0) {
        int n = stack[--top];
        vec4 a = texelFetch(uTree, place(2 * n), 0), b = texelFetch(uTree, place(2 * n + 1), 0);
        if (!meets_box(a.xyz, b.xyz, origin, inverse, low, best.t >= 0.0 ? best.t : high)) continue;
        if (b.w > 0.0) {
            for (int i = 0; i < int(b.w); i++) trace_instance(int(a.w) + i, origin, direction, low, sliced, spread, offset, best);
            if (any && best.t >= 0.0) return best;
        } else if (top + 2 <= STACK) {
            stack[top++] = int(a.w);
            stack[top++] = int(-b.w);
        }
    }
    if (best.t > high) best.t = -1.0;
    return best;
}

vec3 to_linear(vec3 c) { return mix(c / 12.92, pow((c + 0.055) / 1.055, vec3(2.4)), greaterThan(c, vec3(0.04045))); }
vec3 to_srgb(vec3 c)
{
    c = clamp(c, 0.0, 1.0);
    return mix(c * 12.92, 1.055 * pow(c, vec3(1.0 / 2.4)) - 0.055, greaterThan(c, vec3(0.0031308)));
}

vec3 unpack_rgb(uint v) { return vec3(float(v & 255u), float(v >> 8 & 255u), float(v >> 16 & 255u)) / 255.0; }

vec3 unpack_normal(uint v)
{
    vec2 p = (vec2(float(v & 255u), float(v >> 8 & 255u)) - 127.0) / 127.0;
    vec3 n = vec3(p, 1.0 - abs(p.x) - abs(p.y));
    if (n.z < 0.0) n.xy = (1.0 - abs(p.yx)) * vec2(p.x < 0.0 ? -1.0 : 1.0, p.y < 0.0 ? -1.0 : 1.0);
    return normalize(n);
}

vec3 hash_color(uint v)
{
    v = (v + 1u) * 2654435761u;
    v = (v ^ v >> 15) * 2246822519u;
    v ^= v >> 13;
    float h = float(v & 1023u) / 1024.0 * 6.0, s = 0.45 + 0.4 * float(v >> 10 & 255u) / 255.0;
    vec3 c = clamp(abs(mod(h + vec3(0.0, 4.0, 2.0), 6.0) - 3.0) - 1.0, 0.0, 1.0);
    return mix(vec3(1.0), c, s) * (0.6 + 0.4 * float(v >> 18 & 255u) / 255.0);
}

vec3 level_color(int level)
{
    return clamp(abs(mod(float(level) * 1.37 + vec3(0.0, 4.0, 2.0), 6.0) - 3.0) - 1.0, 0.0, 1.0) * 0.8 + 0.1;
}

void attributes(Hit h, out uvec2 value, out uint emissive, out uint flags)
{
    vec4 more = texelFetch(uInstances, place(7 * h.instance + 6), 0);
    uvec4 asset = texelFetch(uAssets, place(2 * int(more.x)), 0);
    uint at = asset.y + ((asset.w & UNNUMBERED) != 0u ? 0u : h.node);
    ivec2 p = ivec2(int(at & 4095u), int(at >> 12));
    value = texelFetch(uAttributes, p, 0).rg;
    flags = asset.w;
    emissive = (flags & HAS_EMISSIVE) != 0u ? texelFetch(uEmissive, p, 0).r : 0u;
}

// Unit normal in the scene, towards the viewer where that is in doubt, as svo-render takes it.
vec3 surface_normal(Hit h, uvec2 value, uint flags, vec3 direction)
{
    int at = 7 * h.instance;
    vec3 x = texelFetch(uInstances, place(at), 0).xyz, y = texelFetch(uInstances, place(at + 1), 0).xyz, z = texelFetch(uInstances, place(at + 2), 0).xyz;
    vec3 view = normalize(direction), n;
    if (h.axis == 3) return uSlice.xyz;
    if ((flags & HAS_NORMAL) != 0u) {
        vec3 g = unpack_normal(value.y);
        n = normalize(x * g.x + y * g.y + z * g.z);
        if (dot(n, view) > 0.25) n = -n;
        return n;
    }
    if (h.axis < 0) return -view;
    n = normalize(h.axis == 0 ? x : h.axis == 1 ? y : z);
    return dot(n, view) > 0.0 ? -n : n;
}

// Far enough above the voxels of a plane through the node that they do not shadow it.
vec3 shadow_origin(Hit h, vec3 n)
{
    int at = 7 * h.instance + 3;
    vec4 x = texelFetch(uInstances, place(at), 0), y = texelFetch(uInstances, place(at + 1), 0), z = texelFetch(uInstances, place(at + 2), 0);
    vec3 g = normalize(x.xyz * n.x + y.xyz * n.y + z.xyz * n.z);
    float edge = exp2(-float(h.level));
    vec3 p = (vec3(h.cell) + 0.5) * edge + 1.5 * (abs(g.x) + abs(g.y) + abs(g.z)) * edge * g;
    return vec3(dot(x.xyz, p) + x.w, dot(y.xyz, p) + y.w, dot(z.xyz, p) + z.w);
}

#ifdef SEE_THROUGH
// Share of what is behind a node that it covers; the begin of the ray is moved behind it. Where a ray goes through several nodes of a surface, each counts by the way
// inside, so that all together count as one, as in svo-render.
float pass(Hit h, uvec2 value, uint flags, vec3 n, vec3 origin, vec3 direction, out float begin)
{
    int at = 7 * h.instance;
    vec4 x = texelFetch(uInstances, place(at), 0), y = texelFetch(uInstances, place(at + 1), 0), z = texelFetch(uInstances, place(at + 2), 0);
    vec3 u = texelFetch(uInstances, place(at + 3), 0).xyz, v = texelFetch(uInstances, place(at + 4), 0).xyz, w = texelFetch(uInstances, place(at + 5), 0).xyz;
    float edge = exp2(-float(h.level)), coverage = float(value.x >> 24) / 255.0;
    vec3 o = vec3(dot(x.xyz, origin) + x.w, dot(y.xyz, origin) + y.w, dot(z.xyz, origin) + z.w);
    vec3 d = safe(vec3(dot(x.xyz, direction), dot(y.xyz, direction), dot(z.xyz, direction)));
    vec3 far = max((vec3(h.cell) * edge - o) / d, (vec3(h.cell + 1) * edge - o) / d), g = abs(normalize(u * n.x + v * n.y + w * n.z));
    float leave = min(min(far.x, far.y), far.z), thick = (flags & THIN) != 0u ? max(max(g.x, g.y), g.z) : g.x + g.y + g.z;
    begin_axis = far.x <= far.y && far.x <= far.z ? 0 : far.y <= far.z ? 1 : 2;
    begin = max(leave, h.t) + 0.01 * edge / max(max(abs(d.x), abs(d.y)), abs(d.z));
    if (coverage >= 1.0) return 1.0;
    return 1.0 - pow(1.0 - coverage, max(leave - h.t, 0.0) * abs(dot(d, normalize(u * n.x + v * n.y + w * n.z))) / (thick * edge));
}
#endif

// Share of the light that arrives.
float sunlight(vec3 origin, float offset)
{
#ifdef SEE_THROUGH
    float light = 1.0, begin = 0.0;
    begin_axis = -1;
    for (int i = 0; i < LAYERS && light > 0.001; i++) {
        Hit h = trace(origin, uLight, begin, 0.0, offset, false);
        if (h.t < 0.0) return light;
        uvec2 value;
        uint emissive, flags;
        attributes(h, value, emissive, flags);
        light *= 1.0 - pass(h, value, flags, surface_normal(h, value, flags, uLight), origin, uLight, begin);
    }
    return light > 0.001 ? light : 0.0;
#else
    return trace(origin, uLight, 0.0, 0.0, offset, true).t >= 0.0 ? 0.0 : 1.0;
#endif
}

// Light from a hit, linear.
vec3 shade(Hit h, uvec2 value, uint emissive, vec3 n, float spread)
{
    vec3 albedo = to_linear(unpack_rgb(value.x)), light = vec3(0.0);
    if (uMode == 2) albedo = level_color(h.level);
    if (uMode == 3) albedo = hash_color(uint(texelFetch(uInstances, place(7 * h.instance + 6), 0).z));
    if (uMode == 4) albedo = hash_color(value.y >> 16);
    if (uMode == 0) light = to_linear(unpack_rgb(emissive));
    float direct = max(0.0, dot(n, uLight));
    if (direct > 0.0 && uShadows != 0) direct *= sunlight(shadow_origin(h, n), spread * h.t);
    return light + albedo * (uAmbient * (0.75 + 0.25 * n.y) + (1.0 - uAmbient) * direct);
}

#ifdef PICK
out uvec4 result;
#else
out vec4 result;
#endif

void main()
{
    vec2 at = gl_FragCoord.xy + uOffset;
    float scale = 2.0 * uHalf / uSize.y;
    vec3 direction = uForward + uRight * ((at.x - uCenter) * scale) + uUp * ((at.y - 0.5 * uSize.y) * scale);
    float spread = uFootprint * scale;
    Hit h = trace(uEye, direction, 0.0, spread, 0.0, false);
    uvec2 value = uvec2(0u);
    uint emissive = 0u, flags = 0u;
    if (h.t >= 0.0) attributes(h, value, emissive, flags);
#ifdef PICK
    uvec3 c = uvec3(h.cell); // at most 21 bits each
    result = uvec4(floatBitsToUint(h.t), uint(h.instance + 1) | uint(h.level) << 24, c.x | c.y << 21, c.y >> 11 | c.z << 10);
#else
    vec3 background = mix(uTop, uBottom, 1.0 - at.y / uSize.y), n;
    if (h.t < 0.0) {
        result = vec4(to_srgb(background), 1.0);
        return;
    }
    n = surface_normal(h, value, flags, direction);
    if (uMode == 1) {
        result = vec4(0.5 * n + 0.5, 1.0);
        return;
    }
    if (uMode == 5) {
        result = vec4(unpack_rgb(value.x), 1.0);
        return;
    }
#ifdef SEE_THROUGH
    vec3 sum = vec3(0.0);
    float seen = 1.0, begin = 0.0;
    for (int i = 0; i < LAYERS; i++) {
        float cover = uMode == 0 ? pass(h, value, flags, n, uEye, direction, begin) : 1.0;
        int axis = begin_axis;
        sum += seen * cover * shade(h, value, emissive, n, spread);
        seen *= 1.0 - cover;
        if (seen < 0.001) break;
        begin_axis = axis;
        h = trace(uEye, direction, begin, spread, 0.0, false);
        if (h.t < 0.0) break;
        attributes(h, value, emissive, flags);
        n = surface_normal(h, value, flags, direction);
    }
    result = vec4(to_srgb(sum + seen * background), 1.0);
#else
    result = vec4(to_srgb(shade(h, value, emissive, n, spread)), 1.0);
#endif
#endif
}
