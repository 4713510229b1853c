// --- many robots, drawn by WebGL ---

// Software drivers take some 30 us for each instance, so that a shape's vertices fetch what they show from textures.
const UNITS = ["from", "to", "tint", "size"]; // units of textures
const ROW = 2048; // texels in a row of a texture
const VERTEX = `#version 300 es
precision highp sampler2D;
uniform sampler2D froms, tos, tints, sizes; // centers of balls, ends of bars [R]; opacity 0 leaves a shape out; factors of the width
uniform ivec3 fromAt, toAt, tintAt, sizeAt; // shape n has item x (n / y) + z
uniform vec4 tint; // of all shapes where tintAt.y is 0
uniform int vertices; // of a shape; 1: corners of the ground, each with a place of its own
uniform vec3 rightward, upward, toward;
uniform vec4 lens; // pixels per R times distance of the eye, that distance [R], width, height [pixels]
uniform vec2 shift; // [pixels]
uniform vec2 depth; // of a distance w [R]: depth.x + depth.y / w
uniform vec2 wide; // half the width of a bar, or a ball's radius: [R], and at least [pixels]
uniform float back; // how much shapes lie behind their place [R]
uniform bool round;
out vec2 inside;
out vec4 color;
out float away, radius;

// Of a ball's square, or beside (x) and along (y) a bar: two triangles.
const vec2 CORNERS[6] = vec2[](vec2(-1, -1), vec2(1, -1), vec2(-1, 1), vec2(-1, 1), vec2(1, -1), vec2(1, 1));

vec3 seen(vec3 point) { // pixels from the middle times distance, distance
  float w = max(lens.y - dot(toward, point), 0.05 * lens.y);
  return vec3(shift.x * w + lens.x * dot(rightward, point), lens.x * dot(upward, point) - shift.y * w, w);
}

vec4 item(sampler2D items, ivec3 at, int n) {
  n = at.x * (n / at.y) + at.z;
  return texelFetch(items, ivec2(n % ${ROW}, n / ${ROW}), 0);
}

void main() {
  int n = gl_VertexID / vertices, k = gl_VertexID % vertices;
  vec2 corner = vertices == 1 ? vec2(0.0) : CORNERS[k];
  float size = sizeAt.y == 0 ? 1.0 : item(sizes, sizeAt, n).x;
  vec3 a = seen(item(froms, fromAt, n).xyz), b = seen(item(tos, toAt, n).xyz), here = round ? a : mix(a, b, 0.5 + 0.5 * corner.y);
  vec2 along = b.xy / b.z - a.xy / a.z;
  vec2 beside = vec2(along.y, -along.x) / max(length(along), 1e-6);
  here.xy += max(size * wide.x * lens.x, wide.y * here.z) * (round ? corner : corner.x * beside);
  away = here.z + back;
  gl_Position = vec4(2.0 * here.xy / lens.zw, (depth.x + depth.y / away) * here.z, here.z);
  inside = corner;
  color = tintAt.y == 0 ? tint : item(tints, tintAt, n);
  if (color.a == 0.0) gl_Position = vec4(0.0, 0.0, 2.0, 1.0);
  radius = size * wide.x;
}`;
const FRAGMENT = `#version 300 es
precision highp float;
in vec2 inside;
in vec4 color;
in float away, radius;
uniform vec2 depth;
uniform bool round, hull;
out vec4 drawn;

void main() {
  vec3 lit = color.rgb;
  float opacity = color.a;
  gl_FragDepth = gl_FragCoord.z;
  if (round) { // lit from the upper left, as in ball()
    float rim = dot(inside, inside), dark = length(inside - vec2(-0.28, 0.28));
    if (rim > 1.0) discard;
    if (hull) opacity *= mix(0.6, 2.0, rim * rim * rim); // its edge stands out
    else lit = dark < 0.65 ? mix(mix(lit, vec3(1.0), 0.5), lit, dark / 0.65) : mix(lit, 0.55 * lit, (dark - 0.65) / 0.65);
    gl_FragDepth = 0.5 + 0.5 * (depth.x + depth.y / (away - radius * sqrt(1.0 - rim)));
  }
  drawn = vec4(lit * opacity, opacity);
}`;

// A program, or null where the browser has no WebGL.
function programOn(gl) {
  const program = gl?.createProgram();
  if (!program) return null;
  for (const [kind, source] of [[gl.VERTEX_SHADER, VERTEX], [gl.FRAGMENT_SHADER, FRAGMENT]]) {
    const shader = gl.createShader(kind);
    gl.shaderSource(shader, source);
    gl.compileShader(shader);
    gl.attachShader(program, shader);
  }
  gl.linkProgram(program);
  return gl.getProgramParameter(program, gl.LINK_STATUS) ? program : null;
}

// The color of a CSS variable with an opacity, each 0 to 1.
const tintOf = (variable, opacity = 1) => [...colorsOf(variable)[0].map((value) => value / 255), opacity];

// A painter of robots, contacts and ground on a canvas of its own; null where the browser has no WebGL.
function manyRobots() {
  const canvas = document.createElement("canvas"), gl = canvas.getContext("webgl2", { antialias: false });
  const program = programOn(gl);
  if (!program) return null;
  const uniform = (name) => gl.getUniformLocation(program, name);
  const textures = {};
  let shown, offsets, fine, reach, tinted, link; // reach: later robot of each contact; tinted: what the textures of colors show; link: fills in contacts
  gl.useProgram(program);
  UNITS.forEach((name, unit) => gl.uniform1i(uniform(`${name}s`), unit));
  gl.enable(gl.DEPTH_TEST);
  gl.enable(gl.BLEND);
  gl.blendFunc(gl.ONE, gl.ONE_MINUS_SRC_ALPHA);

  // Stores items of as many values each in a texture.
  const keep = (name, values, each) => {
    const rows = Math.ceil(values.length / each / ROW) || 1, padded = new values.constructor(each * ROW * rows);
    padded.set(values);
    gl.bindTexture(gl.TEXTURE_2D, textures[name] ||= gl.createTexture());
    const [inner, format, type] = { 1: [gl.R32F, gl.RED, gl.FLOAT], 3: [gl.RGB32F, gl.RGB, gl.FLOAT], 4: [gl.RGBA8, gl.RGBA, gl.UNSIGNED_BYTE] }[each];
    gl.texImage2D(gl.TEXTURE_2D, 0, inner, ROW, rows, 0, format, type, padded);
    for (const filter of [gl.TEXTURE_MIN_FILTER, gl.TEXTURE_MAG_FILTER]) gl.texParameteri(gl.TEXTURE_2D, filter, gl.NEAREST);
  };
  // Takes places, colors or sizes of shapes from a texture, a new item each `every` shapes.
  const feed = (name, texture, every = 1, { step = 1, start = 0 } = {}) => {
    gl.activeTexture(gl.TEXTURE0 + UNITS.indexOf(name));
    gl.bindTexture(gl.TEXTURE_2D, textures[texture]);
    gl.uniform3i(uniform(`${name}At`), step, every, start);
  };
  const plain = (color) => {
    gl.uniform3i(uniform("tintAt"), 0, 0, 0);
    gl.uniform4f(uniform("tint"), ...color);
  };
  const shapes = (count, { round = false, wide, back = 0, vertices = 6 }) => {
    gl.uniform1i(uniform("round"), round);
    gl.uniform2f(uniform("wide"), ...wide);
    gl.uniform1f(uniform("back"), back);
    gl.uniform1i(uniform("vertices"), vertices);
    gl.drawArrays(gl.TRIANGLES, 0, vertices * count);
  };
  // Robots at true or estimated poses; their colors and opacities are filled in again if `key` is another.
  const robots = (poses, count, key, colorOf, arm, back) => {
    const each = offsets.length;
    if (tinted[poses] !== key) {
      const tints = new Uint8Array(4 * shown.robot.length);
      shown.robot.forEach((_, n) => tints.set(colorOf(n), 4 * n));
      keep(`${poses} tints`, tints, 4);
      tinted[poses] = key;
    }
    feed("from", `${poses} docks`);
    feed("to", poses, each);
    feed("tint", `${poses} tints`, each);
    shapes(count * each, { round: true, wide: [1, 1.5], back });
    if (fine < 2) return; // pixels per R: docks hide the arms
    if (arm) plain(arm);
    shapes(count * each, { wide: [0.15, 0.4], back });
  };
  // The nearest surface of all spheres, once: depths first, then color where a sphere has that depth.
  const spheres = (count) => {
    for (const name of ["from", "to"]) feed(name, "estimate");
    feed("size", "spheres");
    plain(tintOf("--sphere", SPHERE));
    gl.uniform1i(uniform("hull"), 1);
    for (const seen of [false, true]) {
      gl.colorMask(seen, seen, seen, seen);
      gl.depthFunc(seen ? gl.EQUAL : gl.LESS);
      shapes(count, { round: true, wide: [1, 0] });
    }
    gl.uniform3i(uniform("sizeAt"), 0, 0, 0);
    gl.uniform1i(uniform("hull"), 0);
    gl.depthFunc(gl.LESS);
  };
  const bars = (from, to, count, color, width, back, pairs) => {
    feed("from", from, 1, pairs);
    feed("to", to, 1, pairs && { ...pairs, start: 1 });
    plain(color);
    shapes(count, { wide: [0, width / 2], back });
  };

  return {
    // Takes a case and the radii of its spheres [R]; places are relative to the middle of its box, where 32 bits are fine.
    load(chosen, docks, middle, radii) {
      if (shown === chosen) return;
      [shown, offsets, tinted] = [chosen, docks, {}];
      const flat = (points) => {
        const places = new Float32Array(3 * points.length);
        points.forEach((point, n) => SIDES.forEach((k) => { places[3 * n + k] = point[k] - middle[k]; }));
        return places;
      };
      const around = (poses, turns) => {
        const each = 3 * docks.length, places = new Float32Array(each * poses.length);
        poses.forEach((center, n) => docksOf(minus(center, middle), turns[n], docks).forEach((dock, k) => places.set(dock, each * n + 3 * k)));
        return places;
      };
      const sensed = around(shown.estimate, shown.sensed);
      link = () => { // sorting many contacts takes long: once they are wanted
        const contacts = chosen.contacts.slice().sort((one, two) => Math.max(one[0], one[2]) - Math.max(two[0], two[2]));
        const ends = new Float32Array(6 * contacts.length), at = (n, k) => 3 * (docks.length * n + k);
        contacts.forEach(([i, a, j, b], n) => [at(i, a), at(j, b)].forEach((from, m) => ends.set(sensed.subarray(from, from + 3), 6 * n + 3 * m)));
        keep("contacts", ends, 3);
        reach = contacts.map(([i, , j]) => Math.max(i, j));
        link = null;
      };
      keep("estimate", flat(shown.estimate), 3);
      keep("estimate docks", sensed, 3);
      keep("true", flat(shown.true), 3);
      keep("true docks", around(shown.true, shown.turn), 3);
      for (const name of UNITS) feed(name, "estimate"); // a unit without a texture is warned of
      gl.uniform3i(uniform("sizeAt"), 0, 0, 0);
      if (radii) keep("spheres", new Float32Array(radii), 1);
      keep("ground", flat(shown.ground.flat().flatMap(([a, b, c, d]) => [a, b, c, a, c, d])), 3);
    },
    // Draws the first `count` robots; false if the graphics card was lost.
    draw(pen, count, wanted, coloring, { look, fit, radius, toward, width, height, dense }) {
      if (gl.isContextLost()) return false;
      const sharp = shown.robot.length > SOLID ? dense : 2 * dense; // few robots have smooth edges
      [canvas.width, canvas.height] = [width * sharp, height * sharp];
      gl.viewport(0, 0, canvas.width, canvas.height);
      gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT);
      fine = look.zoom * fit;
      const distance = 4 * radius, [near, far] = [0.05 * distance, 2 * distance];
      const [ct, st, ce, se] = [Math.cos(look.turn), Math.sin(look.turn), Math.cos(look.tilt), Math.sin(look.tilt)];
      gl.uniform3f(uniform("rightward"), -st, ct, 0);
      gl.uniform3f(uniform("upward"), -se * ct, -se * st, ce);
      gl.uniform3f(uniform("toward"), ...toward);
      gl.uniform4f(uniform("lens"), look.zoom * fit * distance, distance, width, height);
      gl.uniform2f(uniform("shift"), look.right, look.down);
      gl.uniform2f(uniform("depth"), (far + near) / (far - near), -2 * far * near / (far - near));
      if (wanted.estimate) {
        const scale = colorsOf(coloring.scale);
        const colorOf = (n) => [...(coloring.value[n] === null ? UNKNOWN_COLOR : along(scale, shareOf(coloring, coloring.value[n]))), 255];
        robots("estimate", count, coloring, colorOf, tintOf("--arm"), 0);
      }
      if (wanted.contacts) {
        link?.();
        const many = reach.findIndex((robot) => robot >= count);
        bars("contacts", "contacts", many < 0 ? reach.length : many, tintOf("--contact"), 2.5, -RAISED, { step: 2 });
      }
      if (wanted.error) bars("true", "estimate", count, tintOf("--ink"), 1.5, 0);
      if (wanted.truth) {
        const [blue, ghost] = [colorsOf("--true")[0], wanted.estimate];
        const near = (n) => Math.hypot(...minus(shown.true[n], shown.estimate[n])) < GHOST.gap;
        const colorOf = (n) => [...blue, !ghost ? 255 : near(n) ? 0 : 255 * GHOST.opacity];
        robots("true", count, `${blue} ${ghost}`, colorOf, null, ghost ? GHOST.back : 0);
      }
      if (wanted.ground) {
        for (const name of ["from", "to"]) feed(name, "ground");
        plain(tintOf("--ground", EARTH));
        shapes(6 * shown.ground.flat().length, { wide: [0, 0], vertices: 1 });
      }
      if (wanted.spheres) spheres(count);
      pen.drawImage(canvas, 0, 0, width, height);
      return true;
    },
  };
}
