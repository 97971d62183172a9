// What the views draw with: shaders, and shapes from the numbers in the page.
const CORNER = `#version 300 es
in vec3 position; in vec3 motion; in float value; in float level;
uniform mat3 turn; uniform vec2 zoom, shift; uniform vec3 way, lift;
uniform float swing, near; uniform bool moving;
out vec3 place; out float shade;
void main() {
  place = turn * (position + swing * motion + level * lift);
  gl_Position = vec4(place.xy * zoom + shift, -0.1 * place.z - near, 1.0);
  shade = moving ? 0.5 + 0.5 * dot(motion, way) : value;
}`;
const COLOUR = `#version 300 es
precision highp float;
in vec3 place; in float shade;
uniform sampler2D ramp; uniform vec4 plain; uniform vec3 none; uniform bool lit;
out vec4 colour;
void main() {
  vec3 base = plain.a > 0.0 ? plain.rgb : shade < -0.001 ? none
    : texture(ramp, vec2((16.0 * clamp(shade, 0.0, 1.0) + 0.5) / 17.0, 0.5)).rgb;
  vec3 n = cross(dFdx(place), dFdy(place));
  float light = lit ? 0.7 + 0.3 * abs(n.z) / max(length(n), 1e-12) : 1.0;
  float alpha = plain.a > 0.0 ? plain.a : 1.0;
  colour = vec4(base * light * alpha, alpha);
}`;
const bytes = text => Uint8Array.from(atob(text), c => c.charCodeAt(0)).buffer;
const shorts = text => new Int16Array(bytes(text));
const product = (a, b) => Array.from({ length: 9 }, (_, k) =>
  a[3 * (k / 3 | 0)] * b[k % 3] + a[3 * (k / 3 | 0) + 1] * b[k % 3 + 3]
  + a[3 * (k / 3 | 0) + 2] * b[k % 3 + 6]);
const rgb = hex => [1, 3, 5].map(i => parseInt(hex.slice(i, i + 2), 16) / 255);
const digits = x => String(Number(x.toPrecision(3)));

/** Triangles of faces, and their edges: of two faces in one plane, and all that bound something. */
function split(faces, corners, points) {
  const triangles = [], inner = [], outer = [], edges = new Map();
  const normal = ([a, b, c]) => {
    const [u, v] = [b, c].map(i => [0, 1, 2].map(k => points[3 * i + k] - points[3 * a + k]));
    const n = [u[1] * v[2] - u[2] * v[1], u[2] * v[0] - u[0] * v[2], u[0] * v[1] - u[1] * v[0]];
    const size = Math.hypot(...n) || 1;
    return n.map(x => x / size);
  };
  for (let f = 0; f < faces.length; f += corners) {
    const around = [...new Set(faces.subarray(f, f + corners))];
    const n = normal(around);
    for (let i = 2; i < around.length; i++) triangles.push(around[0], around[i - 1], around[i]);
    around.forEach((a, i) => {
      const b = around[(i + 1) % around.length];
      const key = a < b ? a * 4294967296 + b : b * 4294967296 + a;
      const other = edges.get(key); // the first face's normal, then whether the edge is flat
      edges.set(key, other ? Math.abs(n[0] * other[0] + n[1] * other[1] + n[2] * other[2]) > 0.86 : n);
    });
  }
  for (const [key, flat] of edges) {
    (flat === true ? inner : outer).push(Math.floor(key / 4294967296), key % 4294967296);
  }
  return [triangles, inner, outer].map(list => new Uint32Array(list));
}

/** Triangles of arrows that grow with the motion: position, motion and so on by corner. */
function arrowShapes(arrows) {
  const position = [], motion = [];
  const put = (p, v, t, offset) => {
    position.push(p[0] + offset[0], p[1] + offset[1], p[2] + offset[2]);
    motion.push(t * v[0], t * v[1], t * v[2]);
  };
  for (let k = 0; k < arrows.points.length; k += 3) {
    const p = arrows.points.slice(k, k + 3), v = arrows.vectors.slice(k, k + 3);
    const size = Math.hypot(...v) || 1e-9;
    const u = Math.abs(v[0]) > 0.7 * size ? [0, 1, 0] : [1, 0, 0];
    let a = [v[1] * u[2] - v[2] * u[1], v[2] * u[0] - v[0] * u[2], v[0] * u[1] - v[1] * u[0]];
    a = a.map(c => c / (Math.hypot(...a) || 1));
    const b = [v[1] * a[2] - v[2] * a[1], v[2] * a[0] - v[0] * a[2], v[0] * a[1] - v[1] * a[0]]
      .map(c => c / size);
    const ring = (radius, i) => {
      const angle = Math.PI * i / 3;
      return a.map((c, j) => radius * (Math.cos(angle) * c + Math.sin(angle) * b[j]));
    };
    const along = v.map(c => c / size);
    const thin = 0.007, wide = arrows.ball ? 0.03 : 0.02, none = [0, 0, 0];
    for (let i = 0; i < 6; i++) {
      const [l, m] = [ring(thin, i), ring(thin, i + 1)], head = arrows.ball ? 1 : 0.72;
      put(p, v, 0, l); put(p, v, 0, m); put(p, v, head, l);
      put(p, v, 0, m); put(p, v, head, m); put(p, v, head, l);
      const [r, s] = [ring(wide, i), ring(wide, i + 1)];
      if (arrows.ball) { // two cones at the end
        for (const sign of [-wide, wide]) {
          put(p, v, 1, r); put(p, v, 1, s); put(p, v, 1, along.map(c => sign * c));
        }
      } else {
        put(p, v, head, r); put(p, v, head, s); put(p, v, 1, none);
      }
    }
  }
  return { position: new Float32Array(position), motion: new Float32Array(motion) };
}
