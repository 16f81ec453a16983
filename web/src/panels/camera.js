/**
 * A camera's picture beside the twin. The robot's programs announce its cameras on `camera/<name>`; who hears that may see them, which
 * the console looks after (console/camera_rights.py). One camera is open at a time, because a person has opened it.
 *
 * A picture is drawn on a canvas, with its age beside it. One that is old is said to be old, and one that is older or whose camera is
 * gone is taken away: a picture that stands still must never look like the present.
 */
import {CameraPackets, GONE_AFTER, OLD_AFTER, PictureAge} from "../camera/packets.js";
import {add, button, clear, setText} from "../dom.js";
import {browser} from "./clock.js";

const LOOK_EVERY = 200;
/** Wait before the next attempt [ms]: at first, and at most. */
const FIRST_WAIT = 1000;
const LONGEST_WAIT = 10000;

/** Draw a JPEG on a canvas; rejected where it is none. */
async function drawJpeg(canvas, jpeg) {
  const picture = await createImageBitmap(new Blob([jpeg], {type: "image/jpeg"}));
  canvas.width = picture.width;
  canvas.height = picture.height;
  canvas.getContext("2d").drawImage(picture, 0, 0);
  picture.close();
}

/** Make the panel. `get`, `draw` and `wait` are for tests. */
export function make(parent, store, connection, texts, {
  now, every, draw = drawJpeg, get = (path, signal) => fetch(path, {credentials: "same-origin", cache: "no-store", signal}),
  wait = (ms) => new Promise((resolve) => {
    setTimeout(resolve, ms);
  }),
} = browser) {
  const bar = add(parent, "div", {className: "camera-bar", role: "group", "aria-label": texts("camera.title"), hidden: true});
  const area = add(parent, "figure", {className: "camera", hidden: true});
  const stage = add(area, "div", {className: "camera-stage"});
  const cover = add(stage, "p", {className: "camera-cover", role: "alert", hidden: true});
  const caption = add(area, "figcaption", {className: "camera-age"});
  // what is open: {robot, name, stop, canvas, age, why}
  let open = null;
  let listed = "";

  const camerasOf = (robot) => store.robot(robot)?.cameras ?? [];

  function showBar() {
    const names = connection.state === "connected" ? camerasOf(store.selected) : [];
    const wanted = JSON.stringify([names, open?.name ?? ""]);
    bar.hidden = names.length === 0;
    if (wanted === listed) return;
    listed = wanted;
    clear(bar);
    for (const name of names) {
      button(bar, texts("camera.button", {name}), () => toggle(name), {"aria-pressed": String(open?.name === name)});
    }
  }

  function toggle(name) {
    const was = open?.name;
    close();
    if (was !== name) begin(store.selected, name);
    showBar();
  }

  function begin(robot, name) {
    const stop = new AbortController();
    const canvas = add(stage, "canvas", {className: "camera-picture", role: "img", "aria-label": texts("camera.of", {name, robot}), width: "1", height: "1"});
    open = {robot, name, stop, canvas, age: new PictureAge(), why: "camera.waits"};
    area.hidden = false;
    parent.classList.add("has-camera");
    show();
    watch(open);
  }

  function close() {
    if (open === null) return;
    open.stop.abort();
    open.canvas.remove();
    open = null;
    area.hidden = true;
    parent.classList.remove("has-camera");
  }

  /** Look at a camera until it is closed, again and again where that ends. */
  async function watch(mine) {
    const {signal} = mine.stop;
    let pause = FIRST_WAIT;
    while (!signal.aborted) {
      try {
        const answer = await get(`private/camera/${encodeURIComponent(mine.robot)}/${encodeURIComponent(mine.name)}`, signal);
        if (!answer.ok) {
          mine.why = {403: "camera.forbidden", 503: "camera.full"}[answer.status] ?? "camera.failed";
        } else {
          if (await follow(mine, answer.body.getReader())) pause = FIRST_WAIT;
          mine.why = "camera.ended";
        }
      } catch (error) {
        if (signal.aborted) return;
        // no network, or what comes is not what the console sends
        mine.why = "camera.failed";
        console.warn(error.message);
      }
      mine.age = new PictureAge();
      if (mine === open) show();
      await wait(pause);
      pause = Math.min(LONGEST_WAIT, 2 * pause);
    }
  }

  /** Show the pictures of one answer until it ends; returns whether there was any. */
  async function follow(mine, reader) {
    const packets = new CameraPackets();
    mine.age = new PictureAge();
    let any = false;
    for (;;) {
      const {done, value} = await reader.read();
      if (done || mine !== open) return any;
      const found = packets.feed(value);
      for (const packet of found) {
        // a camera that is gone has no newest picture, however short ago the last one came
        if (!packet.there) mine.age = new PictureAge();
        mine.age.take(packet, now());
        mine.why = packet.there ? "camera.old" : "camera.away";
      }
      const newest = found.findLast(({jpeg}) => jpeg !== null);
      if (newest !== undefined) {
        try {
          await draw(mine.canvas, newest.jpeg);
          any = true;
        } catch (error) {
          mine.age = new PictureAge();
          mine.why = "camera.no_picture";
          console.warn(error.message);
        }
      }
      if (mine === open) show();
    }
  }

  function show() {
    if (open === null) return;
    const age = open.age.at(now());
    const gone = age === null || age > GONE_AFTER;
    if (gone) open.canvas.width = open.canvas.height = 1;
    const seconds = age === null ? "" : (age / 1000).toFixed(age < 10000 ? 1 : 0);
    area.classList.toggle("is-old", !gone && age > OLD_AFTER);
    area.classList.toggle("is-gone", gone);
    cover.hidden = !gone && age <= OLD_AFTER;
    setText(cover, gone ? texts(open.why === "camera.old" ? "camera.away" : open.why, {name: open.name})
      : cover.hidden ? "" : texts("camera.old", {seconds: Math.floor(age / 1000)}));
    setText(caption, gone ? texts("camera.none", {name: open.name}) : texts("camera.age", {name: open.name, seconds}));
  }

  const look = () => {
    // the right ends with the announcement, the login and the robot that is shown
    if (open !== null && (open.robot !== store.selected || connection.state !== "connected" || !camerasOf(open.robot).includes(open.name))) close();
    showBar();
  };
  for (const kind of ["cameras", "selected", "connection"]) store.on(kind, look);
  parent.ownerDocument.addEventListener("visibilitychange", () => {
    // nobody looks: the camera is left alone, and asked anew later
    if (parent.ownerDocument.visibilityState === "hidden") {
      close();
      showBar();
    }
  });
  every(LOOK_EVERY, show);
  look();
}
