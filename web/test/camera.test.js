/** A camera's picture: what the console sends, how old it is, and that none that stands still looks like the present. */
import assert from "node:assert/strict";
import {test} from "node:test";
import {CameraPackets, GONE_AFTER, OLD_AFTER, PictureAge} from "../src/camera/packets.js";
import * as camera from "../src/panels/camera.js";
import {fakePage, view} from "./support/fake.js";

/** A packet as console/camera_delivery.py makes it. */
function packet({jpeg = [], age = 0, sent = 0, there = true} = {}) {
  const bytes = new Uint8Array(13 + jpeg.length);
  const head = new DataView(bytes.buffer);
  head.setUint32(0, jpeg.length);
  head.setUint32(4, age);
  head.setUint32(8, sent);
  head.setUint8(12, there ? 1 : 0);
  bytes.set(jpeg, 13);
  return bytes;
}

test("packets are the same however the bytes are cut, and one that is too long is refused", () => {
  const all = [packet({jpeg: [1, 2, 3], age: 70, sent: 1000}), packet({there: false}), packet({jpeg: [9], sent: 2 ** 32 - 1})];
  const stream = new Uint8Array(all.flatMap((each) => [...each]));
  for (let size = 1; size <= stream.length; size += 1) {
    const reader = new CameraPackets();
    const found = [];
    for (let at = 0; at < stream.length; at += size) found.push(...reader.feed(stream.slice(at, at + size)));
    assert.deepEqual(found.map(({jpeg, age, sent, there}) => [jpeg && [...jpeg], age, sent, there]),
      [[[1, 2, 3], 70, 1000, true], [null, 0, 0, false], [[9], 0, 4294967295, true]]);
  }
  assert.throws(() => new CameraPackets().feed(new Uint8Array([255, 255, 255, 255, ...Array(9).fill(0)])), RangeError);
});

test("a picture ages at the console, on its way and here", () => {
  const age = new PictureAge();
  assert.equal(age.at(0), null);
  age.take({jpeg: [1], age: 50, sent: 0}, 1000);
  assert.equal(age.at(1000), 50);
  assert.equal(age.at(1500), 550);
  // half a second longer on its way than the first one
  age.take({jpeg: [1], age: 50, sent: 1000}, 2500);
  assert.equal(age.at(2500), 550);
  // a head alone changes nothing
  age.take({jpeg: null, age: 900, sent: 2000}, 3000);
  assert.equal(age.at(3000), 1050);
});

/** A page with the panel; `send(bytes)` and `end()` are the console's of the newest request. */
async function page({status = 200, draw = async () => {}, cameras = ["front"]} = {}) {
  const fake = fakePage({account: "vic"});
  const timers = [];
  const asked = [];
  const it = {...fake, asked, status, drawn: [], pauses: []};
  const settle = async () => {
    for (let k = 0; k < 6; k += 1) await new Promise((resolve) => setImmediate(resolve));
  };
  let goOn = () => {};
  camera.make(fake.parent, fake.store, fake.connection, fake.texts, {
    now: () => fake.clock.now,
    every: (ms, call) => timers.push(call),
    draw: async (canvas, jpeg) => {
      await draw(jpeg);
      it.drawn.push([...jpeg]);
      canvas.width = 640;
    },
    get: async (path, signal) => {
      asked.push({path, signal});
      return {ok: it.status === 200, status: it.status, body: new ReadableStream({
        start(controller) {
          it.send = async (...packets) => {
            for (const each of packets) controller.enqueue(each);
            await settle();
          };
          it.end = async () => {
            controller.close();
            await settle();
          };
        },
      })};
    },
    wait: (ms) => {
      it.pauses.push(ms);
      return new Promise((resolve) => {
        goOn = resolve;
      });
    },
  });
  it.again = async () => {
    goOn();
    await settle();
  };
  it.pass = async (ms) => {
    fake.later(ms);
    timers.forEach((call) => call());
    await settle();
  };
  it.find = (selector) => fake.parent.querySelector(selector);
  it.text = (selector) => it.find(selector).textContent;
  it.announce = (name, there = true) => fake.hear("kr120", `camera/${name}`, there ? {name} : null, true);
  await it.hear("kr120", "view", view());
  for (const name of cameras) await it.announce(name);
  it.press = async (number = 0) => {
    it.click([...it.parent.querySelectorAll(".camera-bar button")][number]);
    await settle();
  };
  return it;
}

test("a camera that is announced can be opened, and its picture has an age", async () => {
  const it = await page();
  assert.equal(it.find(".camera-bar").hidden, false);
  assert.equal(it.asked.length, 0);
  await it.press();
  assert.equal(it.asked[0].path, "private/camera/kr120/front");
  assert.equal(it.text(".camera-cover"), it.texts("camera.waits", {name: "front"}));
  // of two that come at once the newer one
  await it.send(new Uint8Array([...packet({jpeg: [1], age: 100}), ...packet({jpeg: [2], age: 100})]));
  assert.deepEqual(it.drawn, [[2]]);
  assert.equal(it.find(".camera-cover").hidden, true);
  assert.equal(it.text(".camera-age"), "front: 0.1 s old");
  await it.press();
  assert.equal(it.find(".camera").hidden, true);
  assert.equal(it.asked[0].signal.aborted, true);
});

test("a picture that stands still is said to be old, then taken away", async () => {
  const it = await page();
  await it.press();
  await it.send(packet({jpeg: [1]}));
  await it.pass(OLD_AFTER + 100);
  assert.equal(it.text(".camera-cover"), "OLD PICTURE: of 2 s ago");
  assert.ok(it.find(".camera").classList.contains("is-old"));
  // heads come, and no picture: it ages all the same
  await it.send(packet({sent: OLD_AFTER + 100}));
  await it.pass(GONE_AFTER);
  assert.ok(it.find(".camera").classList.contains("is-gone"));
  assert.equal(it.text(".camera-cover"), it.texts("camera.away", {name: "front"}));
  assert.equal(it.find("canvas").width, 1);
  await it.send(packet({jpeg: [3], sent: OLD_AFTER + 100 + GONE_AFTER}));
  assert.equal(it.find(".camera-cover").hidden, true);
});

test("a camera that is gone is said at once, though its last picture is young", async () => {
  const it = await page();
  await it.press();
  await it.send(packet({jpeg: [1]}), packet({there: false}));
  assert.equal(it.text(".camera-cover"), it.texts("camera.away", {name: "front"}));
  assert.equal(it.text(".camera-age"), "front: no picture");
  assert.equal(it.find("canvas").width, 1);
});

test("why there is no picture is said, and the console is asked less and less often", async () => {
  for (const [status, key] of [[403, "camera.forbidden"], [503, "camera.full"], [500, "camera.failed"]]) {
    const it = await page({status});
    await it.press();
    assert.equal(it.text(".camera-cover"), it.texts(key, {name: "front"}));
    for (let k = 0; k < 5; k += 1) await it.again();
    assert.deepEqual(it.pauses.slice(0, 6), [1000, 2000, 4000, 8000, 10000, 10000]);
    it.status = 200;
    await it.again();
    await it.send(packet({jpeg: [1]}));
    assert.equal(it.find(".camera-cover").hidden, true);
    await it.end();
    assert.equal(it.text(".camera-cover"), it.texts("camera.ended", {name: "front"}));
    assert.equal(it.pauses.at(-1), 1000);
  }
});

test("what is no picture is not shown", async () => {
  const it = await page({draw: async () => Promise.reject(new Error("no JPEG"))});
  await it.press();
  await it.send(packet({jpeg: [1]}));
  assert.equal(it.text(".camera-cover"), it.texts("camera.no_picture", {name: "front"}));
});

test("a camera that is announced no more, another robot, a lost connection end it; one camera is open at a time", async () => {
  const ends = [
    (it) => it.announce("front", false),
    async (it) => {
      await it.hear("kr60", "view", view());
      it.store.select("kr60");
    },
    (it) => it.connection.change("lost"),
  ];
  for (const end of ends) {
    const it = await page({cameras: ["front", "side"]});
    await it.press(1);
    await it.press(0);
    assert.deepEqual(it.asked.map(({path, signal}) => [path, signal.aborted]),
      [["private/camera/kr120/side", true], ["private/camera/kr120/front", false]]);
    await end(it);
    assert.equal(it.find(".camera").hidden, true);
    assert.equal(it.asked[1].signal.aborted, true);
  }
});

test("cameras are names, not too many, and not kept beyond the connection", async () => {
  const it = await page({cameras: []});
  for (let k = 0; k < 40; k += 1) await it.announce(`c${k}`);
  assert.equal(it.store.robot("kr120").cameras.length, 16);
  const before = it.store.refused;
  for (const wrong of ["a/b", "", "ü", "x".repeat(40)]) await it.announce(wrong);
  assert.equal(it.store.refused, before + 4);
  await it.hear("kr120", "camera/side", null, true);
  it.connection.change("lost");
  assert.equal(it.store.robot("kr120").cameras, null);
  assert.equal(it.find(".camera-bar").hidden, true);
});
