// The page: a stream of frames, drawn; and where it is live, the operator's hand.

import { Keys, Pad } from "optsc/devices";
import { Hand } from "optsc/hand";
import { Handle } from "optsc/handle";
import { ACTIONS, Panel } from "optsc/panel";
import { Player } from "optsc/player";
import { Plots } from "optsc/plots";
import { Socket, embedded } from "optsc/stream";
import { View } from "optsc/view";
import { Headset } from "optsc/xr";

// What the jaws meet is felt; by the words of optsc/control/modes.py.
const CONTACTS = [
  "the jaws hold the object", "the jaws have closed on nothing", "something wider than the grasp has stopped the jaws",
  "what the jaws hold slips", "what the jaws hold stands on something",
];
const light = new URLSearchParams(location.search).has("light");
const canvas = document.getElementById("canvas");
const view = new View(canvas, light);
const plots = new Plots(document.getElementById("plots"));
const recorded = embedded();
let newest = null;
let drawn = null;

// For tests and for whoever is curious: what the page knows.
window.optsc = { view, get moment() { return newest; } };

if (recorded) replay();
else live();

function replay() {
  document.body.classList.add("replay");
  view.build(recorded.scene, recorded.numbers);
  const nobody = { source: null, drives: false };
  const panel = new Panel(() => {}, () => {}, () => {});
  panel.build(recorded.scene);
  const player = new Player(document.getElementById("player"), recorded.moments, (moment) => {
    newest = moment;
    view.show(moment);
    panel.settings(moment.settings);
    panel.show(moment, nobody);
    plots.show(moment);
  });
  document.querySelectorAll("#panel input, #panel select").forEach((input) => (input.disabled = true));
  window.optsc.player = player;
  let last = performance.now();
  view.renderer.setAnimationLoop((now) => {
    player.advance(Math.max(0, now - last) / 1000);
    last = now;
    view.draw();
  });
}

function live() {
  const socket = new Socket({ scene: build, moment: take, said, lost });
  const hand = new Hand(socket);
  const handle = new Handle(view, hand);
  const panel = new Panel(
    (values) => socket.send({ kind: "settings", values }),
    (name) => hand.press(name),
    () => socket.send({ kind: "settings", values: { restarts: (panel.values.restarts || 0) + 1 } }),
  );
  const shortcuts = Object.fromEntries(ACTIONS.map((action) => [action.key, () => panel.buttons?.[action.name]?.click()]));
  new Keys(view, hand, shortcuts);
  const pad = new Pad(view, hand);
  const headset = new Headset(view, hand, document.getElementById("devices"));
  addButtons(headset);
  let mode = null;
  let events = null;
  Object.assign(window.optsc, { hand, handle, headset, panel, socket });

  function build(scene, numbers) {
    view.build(scene, numbers);
    panel.build(scene);
  }

  function take(moment) {
    newest = moment;
    hand.follow(moment.of("target"));
    hand.everMoved ||= hand.source !== null && hand.position.distanceTo(hand.start.hand) > 0.05;
    feel(moment);
    plots.show(moment);
  }

  // A change of mode is felt, and so are jaws that meet something.
  function feel(moment) {
    const event = moment.scene.events[moment.one("event")];
    if (mode !== null && moment.mode !== mode) pulse(moment.mode === "hold" ? 1 : 0.5, moment.mode === "hold" ? 160 : 60);
    if (events !== null && moment.one("events") !== events && CONTACTS.includes(event)) pulse(1, 120);
    mode = moment.mode;
    events = moment.one("events");
  }

  function pulse(strength, duration) {
    pad.pulse(strength, duration);
    headset.pulse(strength, duration);
  }

  function said(message) {
    if (message.kind === "settings") {
      panel.settings(message.values);
      hand.rescale(message.values.scale);
    } else if (message.kind === "role") {
      hand.drives = message.drives;
      if (!message.drives) hand.letGo(hand.source);
      panel.role(message, () => socket.send({ kind: "claim" }));
    } else if (message.kind === "refused") {
      console.warn(`refused: ${message.why}`);
    }
  }

  function lost() {
    hand.drives = false;
    hand.letGo(hand.source);
    panel.banner("No connection", "the arm holds; trying again", "stopped", true);
    newest = null;
  }

  let last = 0;
  view.renderer.setAnimationLoop((now, frame) => {
    headset.frame(frame);
    if (!frame && now - last < view.period) return;
    last = now;
    if (newest && newest !== drawn) {
      view.show(newest);
      panel.show(newest, hand);
      drawn = newest;
    }
    if (newest) handle.show(newest);
    view.draw();
  });
}

function addButtons(headset) {
  const place = document.getElementById("devices");
  const look = document.createElement("button");
  look.textContent = "Re-centre view";
  look.id = "recentre";
  look.onclick = () => {
    view.lookFromTheStart();
    headset.stand(0);
  };
  const grasps = document.createElement("button");
  grasps.textContent = "Candidates";
  grasps.className = "on";
  grasps.onclick = () => {
    view.showCandidates = !view.showCandidates;
    grasps.classList.toggle("on", view.showCandidates);
    drawn = null;
  };
  place.append(look, grasps);
}
