import assert from "node:assert/strict";
import {test} from "node:test";
import {WITHOUT_PIN, withPin} from "../src/connection.js";
import * as login from "../src/login.js";
import * as pairing from "../src/pairing.js";
import {fakePage} from "./support/fake.js";

const ADA = {account: "ada", device_account: "ada-device", number: 3, tries: 5};
const TOKEN = "T".repeat(43);
const settled = () => new Promise((resolve) => setImmediate(resolve));

/** A page whose console says `device`, and whose connection notes what it is asked for. */
async function setUp({device = ADA, token = "", answers = [], replaced = []} = {}) {
  const page = fakePage();
  const {connection, document} = page;
  const did = [];
  const clock = {wall: 1e6, steady: 0, timers: []};
  const said = {device};
  connection.state = "off";
  connection.login = (name = "", secret = "") => {
    did.push(["login", name, secret]);
    connection.account = name;
    connection.change("connected");
  };
  connection.replace = async (name, secret) => {
    did.push(["replace", name, secret]);
    const why = replaced.shift() ?? "";
    if (why === "") {
      connection.account = name;
      connection.change("connected");
    }
    return why;
  };
  const place = document.createElement("section");
  page.parent.append(place);
  const form = login.make(page.parent, page.store, connection, page.texts);
  let hash = () => {};
  const own = {
    token, wall: () => clock.wall, steady: () => clock.steady,
    ask: async () => said.device,
    pair: async (...used) => {
      did.push(["pair", ...used]);
      return answers.shift();
    },
    setTimeout: (...it) => clock.timers.push(it),
    clearTimeout: () => {},
    takeToken: () => own.next ?? "",
    onHash: (listener) => {
      hash = listener;
    },
  };
  await pairing.make(page.store, connection, page.texts, form, place, own);
  const section = document.querySelector(".pin");
  const button = (text) => [...section.querySelectorAll("button")].find((each) => each.textContent === text);
  return {
    ...page, did, said, own, section,
    told: () => document.querySelector(".pin-told").textContent,
    locked: () => document.body.classList.contains("is-locked"),
    press: (text) => page.click(button(text)),
    async type(pin) {
      for (const digit of pin) page.click(button(digit));
      page.click(button("OK"));
      await settled();
    },
    see(visible) {
      Object.defineProperty(document, "visibilityState", {configurable: true, get: () => (visible ? "visible" : "hidden")});
      document.dispatchEvent(new page.window.Event("visibilitychange"));
    },
    pass(ms) {
      clock.wall += ms;
      clock.steady += ms;
    },
    timers: clock.timers,
    async scan(next) {
      own.next = next;
      hash();
      await settled();
    },
  };
}

test("a paired device begins with the account that sees and stops, and the PIN opens the person's", async () => {
  const page = await setUp();
  assert.deepEqual(page.did, [["login", "ada-device", WITHOUT_PIN]]);
  assert.deepEqual([page.locked(), page.section.hidden], [true, false]);
  await page.type("48213");
  assert.match(page.told(), /did not count/);
  assert.equal(page.did.length, 1);
  await page.type("482139");
  assert.deepEqual(page.did[1], ["replace", "ada", withPin("482139")]);
  assert.deepEqual([page.locked(), page.section.hidden], [false, true]);
});

test("whoever is not paired sees no pad, and logs in as before", async () => {
  for (const device of [{account: "", device_account: "", number: 0, tries: 0}, null]) {
    const page = await setUp({device});
    assert.deepEqual(page.did, [["login", "", ""]]);
    assert.deepEqual([page.locked(), page.section.hidden], [false, true]);
    page.see(false);
    page.pass(1e9);
    page.see(true);
    assert.equal(page.did.length, 1);
  }
});

test("a wrong PIN is told with what is left, and the device goes on seeing and stopping", async () => {
  const page = await setUp({replaced: ["wrong_pin", "closed"]});
  page.said.device = {...ADA, tries: 4};
  await page.type("482138");
  assert.match(page.told(), /Tries left: 4/);
  assert.deepEqual([page.locked(), page.connection.account], [true, "ada-device"]);
  await page.type("482139");
  assert.match(page.told(), /did not answer/);
  await page.type("482139");
  assert.equal(page.locked(), false);
});

test("a device whose PIN was erased has no pad, and the password opens it", async () => {
  const page = await setUp({device: {...ADA, tries: 0}, replaced: ["refused", ""]});
  assert.equal(page.document.querySelector(".pin-pad").hidden, true);
  page.press(page.texts("pin.with_password"));
  const form = page.section.querySelector("form");
  const submit = async () => {
    page.enter(form.querySelector("[name=account]"), "ada");
    page.enter(form.querySelector("[name=password]"), "secret");
    form.dispatchEvent(new page.window.Event("submit", {bubbles: true, cancelable: true}));
    await settled();
  };
  await submit();
  assert.equal(form.querySelector(".wrong").textContent, page.texts("login.wrong"));
  assert.equal(page.locked(), true);
  await submit();
  assert.deepEqual(page.did.at(-1), ["replace", "ada", "secret"]);
  assert.equal(page.locked(), false);
});

test("a minute out of sight locks at once, and on the way back where no timer ran", async () => {
  const page = await setUp();
  await page.type("482139");
  page.see(false);
  page.pass(59000);
  page.see(true);
  assert.equal(page.locked(), false);
  page.see(false);
  page.pass(60000);
  page.timers.at(-1)[0]();
  assert.deepEqual([page.locked(), page.did.at(-1)], [true, ["login", "ada-device", WITHOUT_PIN]]);
  page.see(true);
  await page.type("482139");
  page.see(false);
  page.pass(3600000);
  page.see(true);
  assert.deepEqual([page.locked(), page.did.at(-1)], [true, ["login", "ada-device", WITHOUT_PIN]]);
});

test("who leaves is asked for the PIN, and a PIN that is no longer taken is said", async () => {
  const page = await setUp();
  await page.type("482139");
  page.connection.change("off");
  assert.deepEqual([page.locked(), page.did.at(-1)], [true, ["login", "ada-device", WITHOUT_PIN]]);
  await page.type("482139");
  page.said.device = {...ADA, tries: 0};
  page.connection.change("refused", "pin_erased");
  await settled();
  assert.equal(page.locked(), true);
  assert.match(page.told(), /No PIN is taken/);
});

test("a device that was revoked is locked no more than any other, and says so", async () => {
  const page = await setUp();
  await page.type("482139");
  page.said.device = {account: "", device_account: "", number: 0, tries: 0};
  page.connection.change("refused", "not_paired");
  await settled();
  assert.deepEqual([page.locked(), page.did.at(-1)], [false, ["login", "", ""]]);
  assert.match(page.document.querySelector(".note").textContent, /not paired any more/);
});

test("an invitation is used with a PIN that was typed twice, and the person is logged in", async () => {
  const nobody = {account: "", device_account: "", number: 0, tries: 0};
  const page = await setUp({device: nobody, token: TOKEN, answers: [{ok: true, account: "ada", device_account: "ada-device", number: 3}]});
  assert.equal(page.section.hidden, false);
  await page.type("123456");
  assert.match(page.told(), /row/);
  await page.type("482139");
  await page.type("482138");
  assert.match(page.told(), /not the same/);
  await page.type("482139");
  await page.type("482139");
  assert.deepEqual(page.did.slice(1), [["pair", TOKEN, "482139"], ["replace", "ada", withPin("482139")]]);
  assert.deepEqual([page.locked(), page.section.hidden], [false, true]);
});

test("a pairing whose answer was lost is found at the console", async () => {
  const nobody = {account: "", device_account: "", number: 0, tries: 0};
  const page = await setUp({device: nobody, token: TOKEN, answers: [{ok: false, why: "unreachable"}]});
  await page.type("482139");
  page.said.device = ADA;
  await page.type("482139");
  assert.deepEqual(page.did.at(-1), ["replace", "ada", withPin("482139")]);
});

test("an invitation that comes to an open page locks it first, and can be declined", async () => {
  const page = await setUp();
  await page.type("482139");
  await page.scan(TOKEN);
  assert.deepEqual([page.locked(), page.did.at(-1)], [true, ["login", "ada-device", WITHOUT_PIN]]);
  page.press(page.texts("pin.decline"));
  assert.equal(page.locked(), true);
  await page.type("482139");
  assert.equal(page.locked(), false);
});
