import assert from "node:assert/strict";
import {test} from "node:test";
import * as login from "../src/login.js";
import {fakePage} from "./support/fake.js";

function form() {
  const page = fakePage();
  login.make(page.parent, page.store, page.connection, page.texts);
  page.shown = () => !page.document.querySelector(".login").hidden;
  page.said = () => page.document.querySelector(".wrong").textContent;
  return page;
}

test("the form comes where the broker wants an account, and goes with the connection", () => {
  const page = form();
  assert.equal(page.shown(), false);
  page.connection.change("refused", "login");
  assert.deepEqual([page.shown(), page.said()], [true, ""]);
  page.connection.change("refused", "refused");
  assert.match(page.said(), /refuses this account or its password/);
  page.connection.change("connected");
  assert.equal(page.shown(), false);
  // who was in is not asked again because the network is away
  page.connection.change("lost", "silent");
  assert.equal(page.shown(), false);
});

test("who waits for a login is told what it waits for: the form covers the rest of the page", () => {
  const page = form();
  page.connection.change("refused", "login");
  page.connection.change("connecting");
  assert.equal(page.said(), page.texts("Connecting ..."));
  page.connection.change("lost", "broker_away");
  assert.equal(page.shown(), true);
  assert.match(page.said(), /NOT CONNECTED.*broker does not answer.*Trying again/);
});
