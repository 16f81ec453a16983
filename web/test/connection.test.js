import assert from "node:assert/strict";
import {EventEmitter} from "node:events";
import {beforeEach, mock, test} from "node:test";
import {makeConnection} from "../src/connection.js";
import {makeStore} from "../src/store.js";
import {view} from "./support/fake.js";

/** A broker's end: what `mqtt.connect` returns, driven by the test. */
class FakeClient extends EventEmitter {
  constructor(url, options) {
    super();
    Object.assign(this, {url, options, connected: false, published: [], subscribed: null, ended: false, pings: 0});
    options.createWebsocket(url, ["mqtt"]);
  }

  subscribe(topics, done) {
    this.subscribed = topics;
    this.answerSubscribe = done;
  }

  publish(topic, payload, options, done) {
    this.published.push({topic, payload, options, done});
  }

  sendPing() {
    this.pings += 1;
  }

  end() {
    this.ended = true;
    this.connected = false;
  }

  /** Be accepted, and have the subscription accepted. */
  accept() {
    this.connected = true;
    this.emit("connect");
    this.answerSubscribe(null);
  }

  refuse(code) {
    this.emit("error", Object.assign(new Error("Connection refused"), {code}));
  }
}

function setUp() {
  const clients = [];
  const sockets = [];
  class FakeSocket extends EventTarget {
    constructor() {
      super();
      sockets.push(this);
    }

    close(code) {
      this.dispatchEvent(Object.assign(new Event("close"), {code}));
    }
  }
  const store = makeStore({now: () => 0, check: async (plan) => ({...plan, refused: ""})});
  const states = [];
  const kept = [];
  const connection = makeConnection(store, {
    url: "ws://127.0.0.1:1/mqtt", prefix: "twin", WebSocket: FakeSocket, keep: (login) => kept.push(login),
    connect: (url, options) => {
      const client = new FakeClient(url, options);
      clients.push(client);
      return client;
    },
  });
  store.on("connection", () => states.push([connection.state, connection.reason]));
  return {clients, sockets, store, connection, states, kept};
}

beforeEach(() => {
  mock.timers.reset();
  mock.timers.enable({apis: ["setTimeout", "setInterval"]});
});

const rejects = (promise, reason) => assert.rejects(promise, (error) => error.reason === reason);

test("the page subscribes to every robot and to its own answers only", () => {
  const {clients, connection} = setUp();
  connection.login("ada", "secret");
  assert.equal(connection.state, "connecting");
  clients[0].accept();
  assert.equal(connection.state, "connected");
  const {subscribed, options} = clients[0];
  assert.equal(options.username, "ada");
  assert.equal(options.clean, true);
  assert.equal(options.reconnectPeriod, 0);
  assert.ok("twin/+/view" in subscribed && "twin/+/plan" in subscribed && "twin/+/work/tasks" in subscribed);
  assert.ok(!Object.keys(subscribed).some((topic) => topic.includes("#") || topic.endsWith("/state")));
});

test("nothing is sent without a connection, neither now nor later", async () => {
  const {clients, sockets, connection} = setUp();
  await rejects(connection.publish("stop/ada", "kr120", {id: "1"}), "not_connected");
  connection.login("ada", "secret");
  await rejects(connection.publish("stop/ada", "kr120", {id: "1"}), "not_connected");
  clients[0].accept();
  sockets[0].close(4001);
  await rejects(connection.publish("stop/ada", "kr120", {id: "1"}), "not_connected");
  mock.timers.tick(600);
  clients[1].accept();
  assert.deepEqual(clients.flatMap((client) => client.published), []);
});

test("what a lost connection leaves open is told, and is not sent again", async () => {
  const {clients, sockets, connection} = setUp();
  connection.login();
  clients[0].accept();
  const verdict = connection.publish("review", "kr120", {verdict: "approved"});
  assert.equal(clients[0].published.length, 1);
  assert.deepEqual(clients[0].published[0].options, {qos: 1, retain: false});
  sockets[0].close(1006);
  await rejects(verdict, "unanswered");
  assert.equal(clients[0].ended, true);
  mock.timers.tick(600);
  clients[1].accept();
  assert.deepEqual(clients[1].published, []);
});

test("the broker's answer decides: taken, nobody there, refused by its rules, or for another reason", async () => {
  const {clients, connection} = setUp();
  connection.login();
  clients[0].accept();
  const publish = () => {
    const promise = connection.publish("stop/console", "kr120", {});
    return {promise, done: clients[0].published.at(-1).done};
  };
  let {promise, done} = publish();
  done(null, {reasonCode: 0});
  assert.equal(await promise, 0);
  ({promise, done} = publish());
  done(null, {reasonCode: 16});
  assert.equal(await promise, 16);
  ({promise, done} = publish());
  done(Object.assign(new Error("Publish error: Not authorized"), {code: 135}));
  await rejects(promise, "refused");
  ({promise, done} = publish());
  done(Object.assign(new Error("Quota exceeded"), {code: 151}));
  await rejects(promise, "broker");
  ({promise} = publish());
  mock.timers.tick(5000);
  await rejects(promise, "unanswered");
});

test("a topic that is more than one is not published", async () => {
  const {clients, connection} = setUp();
  connection.login();
  clients[0].accept();
  await rejects(connection.publish("stop/+", "kr120", {}), "format");
  await rejects(connection.publish("stop/a", "", {}), "format");
  assert.deepEqual(clients[0].published, []);
});

test("a broker that goes away is shown at once with its reason, and what was heard is not the present any more", async () => {
  const {clients, sockets, store, connection, states} = setUp();
  connection.login();
  clients[0].accept();
  clients[0].emit("message", "twin/kr120/view", Buffer.from(JSON.stringify(view())), {retain: false});
  assert.notEqual(store.robot("kr120").view, null);
  sockets[0].close(4001);
  assert.deepEqual(states.at(-1), ["lost", "broker_away"]);
  assert.equal(store.robot("kr120").view, null);
  mock.timers.tick(600);
  assert.equal(clients.length, 2);
  assert.equal(connection.state, "lost");
  // what the old client still says is nothing
  clients[0].emit("message", "twin/kr120/view", Buffer.from(JSON.stringify(view())), {retain: false});
  assert.equal(store.robot("kr120").view, null);
  clients[1].accept();
  assert.deepEqual(states.at(-1), ["connected", ""]);
});

test("attempts come less and less often, and one after the other", () => {
  const {clients, sockets, connection} = setUp();
  connection.login();
  const waits = [500, 1000, 2000, 4000, 5000, 5000];
  waits.forEach((wait, k) => {
    sockets[k].close(1006);
    mock.timers.tick(wait - 1);
    assert.equal(clients.length, k + 1);
    mock.timers.tick(1);
    assert.equal(clients.length, k + 2);
  });
  assert.ok(clients.slice(0, -1).every((client) => client.ended));
});

test("a refused login is not tried again; without an account it asks for one", () => {
  const {clients, connection, states} = setUp();
  connection.login();
  clients[0].refuse(135);
  assert.deepEqual(states.at(-1), ["refused", "login"]);
  connection.login("ada", "wrong");
  clients[1].refuse(134);
  assert.deepEqual(states.at(-1), ["refused", "refused"]);
  mock.timers.tick(60000);
  assert.equal(clients.length, 2);
});

test("who logs out is not connected and the next login begins anew", async () => {
  const {clients, connection} = setUp();
  connection.login("ada", "secret");
  clients[0].accept();
  connection.logout();
  assert.equal(connection.state, "off");
  assert.equal(connection.account, "");
  assert.equal(clients[0].ended, true);
  await rejects(connection.publish("stop/ada", "kr120", {}), "not_connected");
});

test("a login is kept once it is accepted, through losses, until it is refused or given up", () => {
  const {clients, sockets, connection, kept} = setUp();
  connection.login("ada", "secret");
  assert.deepEqual(kept, []);
  clients[0].accept();
  sockets[0].close(4001);
  assert.deepEqual(kept, [["ada", "secret"]]);
  mock.timers.tick(600);
  clients[1].refuse(135);
  assert.deepEqual(kept.pop(), null);
  connection.login("ada", "secret");
  clients[2].accept();
  connection.logout();
  assert.deepEqual(kept.slice(-2), [["ada", "secret"], null]);
  connection.login();
  clients[3].accept();
  assert.equal(kept.at(-1), null);
});

test("on a broker without accounts answers go to console, and a verdict names no account", () => {
  const {clients, connection} = setUp();
  connection.login();
  clients[0].accept();
  assert.equal(connection.own("stop"), "stop/console");
  assert.equal(connection.own("review"), "review");
});

test("a broker that refuses a part of the subscription leaves the rest; one that takes none of it does not count", () => {
  const {clients, connection} = setUp();
  connection.login("ada", "secret");
  clients[0].connected = true;
  clients[0].emit("connect");
  clients[0].answerSubscribe(Object.assign(new Error("Subscribe error: Not authorized"), {code: 135}));
  assert.equal(connection.state, "connected");
  connection.login("ada", "secret");
  clients[1].connected = true;
  clients[1].emit("connect");
  clients[1].answerSubscribe(new Error("closed"));
  assert.deepEqual([connection.state, connection.reason], ["lost", "subscribe"]);
});
