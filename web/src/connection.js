/**
 * The connection to the broker, by MQTT 5 on a WebSocket of this server: one account, no queue.
 *
 * A message is sent while connected or not at all: each connection has a client of its own, so nothing that was not
 * answered is sent again by the next. What a lost connection leaves open is told as `unanswered`: it may have arrived.
 */
import mqtt from "mqtt";
import {TOPICS} from "./store.js";
import {mark} from "./texts.js";

/** Wait before the next attempt [ms]: at first, and at most. */
const FIRST_WAIT = 500;
const LONGEST_WAIT = 5000;
/** The broker is asked for a sign of life so often [ms], and the connection counts as lost after so long without any [ms]. */
const PING_EVERY = 1000;
const SILENCE = 3000;
/** Longest wait for the broker's answer to a message [ms]. */
const ANSWER_WITHIN = 5000;
/** Close codes of the pipe (console/pipe.py) and the reasons that the page tells. */
const CLOSED = {4001: "broker_away", 4002: "not_mqtt", 4003: "too_much"};
/** Reason codes of CONNACK that another attempt with the same account does not change. */
const REFUSED = [4, 5, 134, 135, 138];
const NOT_AUTHORIZED = 135;
const STATES = {
  off: mark("Not connected."),
  connecting: mark("Connecting ..."),
  connected: mark("Connected."),
  lost: mark("NOT CONNECTED. Nothing that is tapped here goes out. {why} Trying again."),
  refused: mark("The broker refuses the login."),
};
const WHY = {
  broker_away: mark("The console runs, and the broker does not answer it."),
  silent: mark("Nothing was heard any more."),
  closed: mark("The connection has ended."),
  not_mqtt: mark("The console has ended the connection: what this page sent was not MQTT."),
  too_much: mark("The console has ended the connection: too many messages or too many connections."),
  subscribe: mark("The broker did not take the subscription."),
};

/** Say what has become of a connection. */
export const whyLost = ({state, reason}, texts) => texts(STATES[state], {why: reason in WHY ? texts(WHY[reason]) : ""});

/**
 * Why a message was not sent, or is not known to have arrived.
 *
 * `reason`: `not_connected` (nothing went out), `refused` (the broker's rules do not allow it to this account),
 * `broker` (the broker refuses it for another reason), `unanswered` (it went out; the connection ended or no answer
 * came), `format` (it cannot be sent).
 */
export class NotPublished extends Error {
  constructor(reason, detail = "") {
    super(detail || reason);
    this.name = "NotPublished";
    this.reason = reason;
  }
}

/**
 * Make the connection; `login` opens it.
 *
 * @param {string} options.url of the WebSocket
 * @param {string} options.prefix of all topics
 * @param {Function} [options.keep] called with account and password once the broker has accepted them, with null when they are void
 */
export function makeConnection(store, {url, prefix, keep = () => {}, connect = mqtt.connect, WebSocket = globalThis.WebSocket}) {
  let client = null;
  let state = "off";
  let reason = "";
  let account = "";
  let password = "";
  let wait = FIRST_WAIT;
  let again = null;
  let watch = null;
  const open = new Set();

  function change(newState, newReason = "") {
    if (state === newState && reason === newReason) return;
    state = newState;
    reason = newReason;
    if (state === "connected" && account !== "") keep([account, password]);
    if (state === "refused" || state === "off") keep(null);
    store.connection(state);
  }

  function drop() {
    clearInterval(watch);
    clearTimeout(again);
    const last = client;
    client = null;
    if (last !== null) last.end(true);
    for (const fail of [...open]) fail(new NotPublished("unanswered"));
  }

  function lose(why) {
    drop();
    // another attempt with the same account and password changes nothing
    if (why === "refused" || why === "login") {
      change("refused", why);
      return;
    }
    change("lost", why);
    again = setTimeout(start, wait);
    wait = Math.min(LONGEST_WAIT, wait * 2);
  }

  function subscribe(mine) {
    mine.subscribe(Object.fromEntries(TOPICS.map(({topic, qos}) => [`${prefix}/+/${topic}`, {qos}])), (error) => {
      if (client !== mine) return;
      // a broker may refuse some: what the account may not read stays unknown, and the rest is shown
      if (error && !(error.code >= 128)) {
        lose("subscribe");
        return;
      }
      wait = FIRST_WAIT;
      change("connected");
    });
  }

  function observe(mine) {
    let lastPacket = performance.now();
    let lastTick = lastPacket;
    mine.on("packetreceive", () => {
      lastPacket = performance.now();
    });
    watch = setInterval(() => {
      const at = performance.now();
      // a suspended page cannot have received anything
      if (at - lastTick > 2 * PING_EVERY) lastPacket = Math.max(lastPacket, at - PING_EVERY);
      lastTick = at;
      if (mine.connected && at - lastPacket > SILENCE) lose("silent");
      else if (mine.connected && at - lastPacket > PING_EVERY / 2) mine.sendPing();
    }, PING_EVERY);
  }

  function start() {
    drop();
    if (state !== "lost") change("connecting", reason);
    let code = 0;
    let failed = null;
    const end = () => {
      if (client === mine) lose(failed ?? CLOSED[code] ?? "closed");
    };
    const mine = connect(url, {
      protocolVersion: 5, clean: true, reconnectPeriod: 0, connectTimeout: 10000, keepalive: 10, resubscribe: false,
      queueQoSZero: false, clientId: `page-${crypto.randomUUID()}`,
      // a timer in a worker of a blob: would need a weaker policy for scripts
      timerVariant: "native",
      ...(account === "" ? {} : {username: account, password}),
      createWebsocket: (address, protocols) => {
        const socket = new WebSocket(address, protocols);
        socket.addEventListener("close", (event) => {
          code = event.code;
          end();
        });
        return socket;
      },
    });
    client = mine;
    mine.on("connect", () => {
      if (client === mine) subscribe(mine);
    });
    mine.on("error", (error) => {
      if (!REFUSED.includes(error.code)) return;
      failed = account === "" ? "login" : "refused";
      end();
    });
    mine.on("close", end);
    mine.on("message", (topic, payload, packet) => {
      if (client !== mine || !topic.startsWith(`${prefix}/`)) return;
      const [robot, ...below] = topic.slice(prefix.length + 1).split("/");
      store.take(robot, below.join("/"), payload.toString(), packet.retain);
    });
    observe(mine);
  }

  /** The topic on which this account writes. On a broker without accounts it is `console`; a verdict has no account there. */
  function own(topic) {
    if (account === "" && topic === "review") return topic;
    return `${topic}/${account || "console"}`;
  }

  return {
    /** `off`, `connecting`, `connected`, `refused`, `lost`. */
    get state() {
      return state;
    },

    /** Why it is refused or lost: `login` (an account is needed), `refused`, `broker_away`, `silent`, `closed`, ... */
    get reason() {
      return reason;
    },

    /** The person's MQTT account; "" on a broker without accounts. */
    get account() {
      return account;
    },

    own,

    /** Connect with an account; without one as nobody, which only a broker without accounts takes. */
    login(name = "", secret = "") {
      account = name;
      password = secret;
      wait = FIRST_WAIT;
      drop();
      state = "connecting";
      reason = "";
      store.connection(state);
      start();
    },

    /** End the connection and forget the password. */
    logout() {
      password = "";
      account = "";
      drop();
      change("off");
    },

    /**
     * Publish now, or not at all. Never retained, never queued.
     *
     * @param {string} topic below the robot's
     * @param {number} [options.qos] 1; 0 for what is worth nothing later
     * @returns {Promise<number>} resolved once the broker has taken it (quality 1), with its reason code: 16 says that
     *   nobody has subscribed; rejected with NotPublished
     */
    publish(topic, robot, payload, {qos = 1} = {}) {
      if (state !== "connected" || client === null || !client.connected) return Promise.reject(new NotPublished("not_connected"));
      if (robot === "" || /[+#\0]/.test(topic + robot)) return Promise.reject(new NotPublished("format", `topic ${robot}/${topic}`));
      store.set("acted", robot, {topic: topic.split("/")[0]});
      return new Promise((resolve, reject) => {
        const finish = (end, value) => {
          clearTimeout(late);
          open.delete(fail);
          end(value);
        };
        const fail = (error) => finish(reject, error);
        const late = setTimeout(() => fail(new NotPublished("unanswered", "the broker did not answer")), ANSWER_WITHIN);
        open.add(fail);
        client.publish(`${prefix}/${robot}/${topic}`, JSON.stringify(payload), {qos, retain: false}, (error, answer) => {
          if (!error) finish(resolve, answer?.reasonCode ?? 0);
          else if (error.code === NOT_AUTHORIZED) fail(new NotPublished("refused", error.message));
          else fail(new NotPublished(error.code >= 128 ? "broker" : "unanswered", error.message));
        });
      });
    },
  };
}
