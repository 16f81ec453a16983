/**
 * What a person must not miss: each thing for which the arm stood still, and what people did, newest first, with who has read it. The
 * robot keeps them, so they outlast this page. Who has the right may acknowledge one, in the name of the account.
 */
import {add, button, clear} from "../dom.js";
import {isBusy, makeRequests, outcome, showOutcome} from "../requests.js";
import {browser} from "./clock.js";

/** Topic of what people did: there is nothing to acknowledge. */
const PERSON = "person";

/** Return the messages that wait for somebody who takes note of them. */
export function unread(messages) {
  return (messages ?? []).filter(({line, acknowledged_by: by}) => by === "" && line.topic !== PERSON);
}

export function make(parent, store, connection, texts, {when = timeOf} = {}) {
  const none = add(parent, "p", {className: "messages-none", text: texts("Nothing has happened yet that needs a person.")});
  const told = add(parent, "p", {className: "messages-told", role: "status"});
  const list = add(parent, "ul", {className: "messages-list"});
  const requests = makeRequests(store, connection, browser, ["acknowledge_ack"], () => show());

  const show = () => {
    const robot = store.robot(store.selected);
    const messages = robot?.messages ?? [];
    const count = unread(messages).length;
    parent.tab?.mark(count ? String(count) : "");
    none.hidden = messages.length > 0;
    const may = store.rightsOf.may(store.selected, "operate") !== false && connection.state === "connected";
    const record = requests.of(store.selected);
    const isSent = ({id}) => record.payload.message === id && isBusy(record);
    // that it is done stands at the message
    showOutcome(told, record, texts, {what: texts("Acknowledge"), hidden: isBusy(record) || outcome(record) === "done"});
    clear(list);
    for (const message of [...messages].reverse()) {
      const {line, until} = message;
      const item = add(list, "li", {className: `message ${line.topic === PERSON ? "is-act" : until === null ? "is-lasting" : ""}`});
      const head = add(item, "p", {className: "message-when"});
      const at = when(message.at, texts);
      add(head, "span", {text: until === null ? texts("since {at}", {at}) : texts("{at}, until {until}", {at, until: when(until, texts)})});
      add(item, "p", {className: "message-what", text: texts.reason(line.sentence)});
      if (message.acknowledged_by) {
        const values = {account: message.acknowledged_by, at: when(message.acknowledged_at, texts)};
        add(item, "p", {className: "message-read", text: texts("Acknowledged by {account}, {at}", values)});
      } else if (line.topic !== PERSON && may) {
        const acknowledge = () => requests.send(store.selected, "acknowledge", {message: message.id});
        button(item, texts("Acknowledge"), acknowledge, {className: "message-acknowledge", disabled: isSent(message)});
      }
    }
  };

  store.on("messages", (robot) => robot === store.selected && show());
  for (const kind of ["connection", "selected", "robots", "rights"]) store.on(kind, show);
  show();
}

/** Return a time of day, with the date where it is another day; "" for none. Times are of the robot's computer [s since 1970]. */
function timeOf(at, texts) {
  if (at === null) return "";
  const date = new Date(1000 * at);
  const today = new Date().toDateString() === date.toDateString();
  return date.toLocaleString(texts.language, today ? {timeStyle: "medium"} : {dateStyle: "short", timeStyle: "medium"});
}
