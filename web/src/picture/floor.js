/**
 * The floor: solid, with a line at each metre, the axes of base_link and numbers at its edges, and the shadows on it. Metres.
 *
 * Colours are those of the page's theme, as they are in the style sheet: they go to the screen as they are.
 */
import {
  CanvasTexture, Color, Group, Mesh, PlaneGeometry, ShaderMaterial, ShadowMaterial, Sprite, SpriteMaterial, SRGBColorSpace, Vector3, Vector4,
} from "three";
import * as colours from "./colours.js";
import {extentOf, gridOf, numbersOf} from "./grid.js";

/** The floor is drawn so far, and fades out into the background from a part of that on [m]. */
const FAR = 60;
/** Height of the numbers' text on the screen, and of its picture [px]. */
const TEXT = 13;
const DRAWN = 48;
/** The numbers stand so far outside of the numbered part, as a part of the distance of two of them. */
const OUTSIDE = 0.16;

const VERTEX = `
varying vec2 at;
void main() {
  at = position.xy;
  gl_Position = projectionMatrix * modelViewMatrix * vec4(position, 1.0);
}`;
const FRAGMENT = `
varying vec2 at;
uniform vec3 plain, line, red, green;
uniform vec4 extent;
uniform float fine, clear;
// how much of a pixel a line of each cell covers; none where the lines would run into each other
vec2 lines(vec2 cells, vec2 pixel, float width) {
  vec2 far = abs(fract(cells - 0.5) - 0.5) / pixel;
  return clamp(width - far, 0.0, 1.0) * (1.0 - smoothstep(0.15, 0.45, pixel));
}
void main() {
  float away = length(at);
  if (away > clear) discard;
  vec2 pixel = max(fwidth(at), vec2(1e-5));
  vec2 metre = lines(at, pixel, 1.1);
  float strength = 0.55 * max(metre.x, metre.y);
  vec2 ten = lines(at / 10.0, pixel / 10.0, 1.3);
  strength = max(strength, 0.75 * max(ten.x, ten.y));
  if (fine > 0.0) {
    vec2 tenth = lines(at * 10.0, pixel * 10.0, 0.9);
    strength = max(strength, 0.25 * fine * max(tenth.x, tenth.y));
  }
  // the numbered part has an edge
  vec4 edge = abs(at.xyxy - extent) / pixel.xyxy;
  vec2 inside = step(extent.xy - pixel, at) * step(at, extent.zw + pixel);
  float rim = max(max(1.3 - edge.x, 1.3 - edge.z), max(1.3 - edge.y, 1.3 - edge.w));
  strength = max(strength, clamp(rim, 0.0, 1.0) * inside.x * inside.y);
  vec3 colour = mix(plain, line, strength);
  // the base stands on it, whether or not shadows are drawn
  colour *= 1.0 - 0.3 * exp(-2.2 * away * away);
  vec2 axis = clamp(1.8 - abs(at.yx) / pixel.yx, 0.0, 1.0) * step(vec2(0.0), at) * step(at, extent.zw);
  colour = mix(mix(colour, red, axis.x), green, axis.y);
  gl_FragColor = vec4(colour, 1.0 - smoothstep(0.45 * clear, clear, away));
}`;

/** A number as a picture that faces the camera, as high on the screen wherever it stands. Null where nothing can be written. */
function written(document, text, colour) {
  const canvas = document.createElement("canvas");
  const pen = canvas.getContext("2d");
  if (!pen) return null;
  const font = `600 ${0.66 * DRAWN}px system-ui, "Segoe UI", Roboto, "DejaVu Sans", sans-serif`;
  pen.font = font;
  canvas.width = Math.ceil(pen.measureText(text).width) + 8;
  canvas.height = DRAWN;
  pen.font = font;
  pen.textBaseline = "middle";
  pen.textAlign = "center";
  pen.fillStyle = colour;
  pen.fillText(text, canvas.width / 2, DRAWN / 2);
  const map = new CanvasTexture(canvas);
  map.colorSpace = SRGBColorSpace;
  const sprite = new Sprite(new SpriteMaterial({map, sizeAttenuation: false, transparent: true, depthWrite: false}));
  sprite.center.set(0.5, 0.5);
  sprite.renderOrder = 1;
  sprite.userData.aspect = canvas.width / DRAWN;
  return sprite;
}

/**
 * Make the floor.
 *
 * @param {Document} document
 * @returns {Group} with `theme`, `cover`, `look`, `shadows`, and `userData` of what is drawn: `height`, `extent`, `numbers`
 */
export function makeFloor(document) {
  const group = new Group();
  const uniforms = {
    plain: {value: new Vector3(0.9, 0.9, 0.9)}, line: {value: new Vector3(0.6, 0.6, 0.6)}, red: {value: new Vector3()}, green: {value: new Vector3()},
    extent: {value: new Vector4(-2, -2, 2, 2)}, fine: {value: 0}, clear: {value: 20},
  };
  const raw = ({value}, colour) => {
    const {r, g, b} = new Color(colour).getRGB({}, SRGBColorSpace);
    value.set(r, g, b);
  };
  const shape = new PlaneGeometry(2 * FAR, 2 * FAR);
  const plate = new Mesh(shape, new ShaderMaterial({uniforms, vertexShader: VERTEX, fragmentShader: FRAGMENT, transparent: true}));
  // after what is solid, most of which hides it, and before what can be seen through
  plate.renderOrder = -2;
  const shade = new Mesh(shape, new ShadowMaterial({opacity: 0.28, polygonOffset: true, polygonOffsetFactor: -1, polygonOffsetUnits: -1, depthWrite: false}));
  shade.renderOrder = -1;
  shade.receiveShadow = true;
  shade.visible = false;
  const numbers = new Group();
  group.add(plate, shade, numbers);
  let ink = "#888888";
  let key = "";
  let scale = 0;

  function write(step, eye) {
    const found = numbersOf(uniforms.extent.value.toArray(), step, eye);
    const wanted = `${ink} ${found.map(({text, x, y}) => `${text} ${x} ${y}`).join()}`;
    if (wanted === key) return;
    key = wanted;
    clear();
    const [left, front, right, rear] = uniforms.extent.value.toArray();
    const out = OUTSIDE * step;
    const beyond = (value, low, high) => (value <= low ? low - out : value >= high ? high + out : value);
    for (const {text, x, y, colour = ink} of found) {
      const sprite = written(document, text, colour);
      if (sprite === null) return;
      sprite.position.set(beyond(x, left, right), beyond(y, front, rear), 0.02);
      numbers.add(sprite);
    }
    for (const [text, colour, x, y] of [["x", colours.AXES[0], right, 0], ["y", colours.AXES[1], 0, rear]]) {
      const sprite = written(document, text, `#${colour.toString(16).padStart(6, "0")}`);
      if (sprite === null) return;
      sprite.position.set(x && x + 4.5 * out, y && y + 4.5 * out, 0.02);
      numbers.add(sprite);
    }
    size();
    group.userData.numbers = found.map(({text}) => text);
  }

  function size() {
    for (const sprite of numbers.children) sprite.scale.set(scale * sprite.userData.aspect, scale, 1);
  }

  function clear() {
    for (const sprite of [...numbers.children]) {
      sprite.material.map.dispose();
      sprite.material.dispose();
      sprite.removeFromParent();
    }
  }

  Object.assign(group.userData, {height: 0, extent: uniforms.extent.value.toArray(), numbers: []});
  return Object.assign(group, {
    /** Take the theme's colours, as the style sheet writes them. */
    theme({plain, line, text}) {
      raw(uniforms.plain, plain);
      raw(uniforms.line, line);
      raw(uniforms.red, colours.AXES[0]);
      raw(uniforms.green, colours.AXES[1]);
      ink = text;
      key = "";
    },
    /** Be as large as what stands on it, at a height. */
    cover(points, height) {
      const extent = extentOf(points);
      uniforms.extent.value.fromArray(extent);
      uniforms.clear.value = Math.min(FAR, 3.2 * Math.max(...extent.map(Math.abs)));
      group.position.z = height;
      Object.assign(group.userData, {height, extent});
      key = "";
    },
    /** Be looked at: `eye` and `target` as positions, by a picture so many pixels high whose height is seen at `fov` [deg]. */
    look(eye, target, fov, high) {
      const slope = 2 * Math.tan(fov * Math.PI / 360) / high;
      const {fine, step} = gridOf(eye.distanceTo(target) * slope);
      uniforms.fine.value = fine;
      if (scale !== TEXT * 1.5 * slope) {
        scale = TEXT * 1.5 * slope;
        size();
      }
      write(step, eye.toArray());
    },
    shadows(on) {
      shade.visible = on;
    },
    end() {
      clear();
    },
  });
}
