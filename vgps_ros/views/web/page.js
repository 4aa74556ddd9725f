// Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
// The program of the page: unpacks what stands in it, and lets a visitor drive the robot.
// window.vgps tells others how the robot fares.

const $ = id => document.getElementById(id);
const clip = (v, low = -1, high = 1) => Math.max(low, Math.min(high, v));
const say = text => { $("say").textContent = text; };

// ---- The contents of the page: each is compressed by gzip, and written as base64.

async function unpacked(name) {
  const packed = Uint8Array.from(atob($(name).textContent), c => c.charCodeAt(0));
  const stream = new Blob([packed]).stream().pipeThrough(new DecompressionStream("gzip"));
  return new Uint8Array(await new Response(stream).arrayBuffer());
}
const text = async name => new TextDecoder().decode(await unpacked(name));

// Returns the address of a module of the page, in which the names of others become their addresses.
async function address(name, others = {}) {
  let source = await text(name);
  for (const [other, place] of Object.entries(others))
    source = source.replaceAll(`'${other}'`, `'${place}'`);
  return URL.createObjectURL(new Blob([source], {type: "text/javascript"}));
}

// ---- The controls: pads, keys and gamepads move axes from -1 to 1, and these the commands.

const KEYS = [["KeyW", "ArrowUp", "KeyS", "ArrowDown"], ["KeyA", "ArrowLeft", "KeyD", "ArrowRight"],
              ["KeyQ", "", "KeyE", ""]];
// REP-103: ahead, and to the left, are positive; of other commands right is.
const side = ({axis}, i) => i && !axis ? -1 : 1;
const GAMEPAD = [pad => -pad.axes[1], pad => -pad.axes[0], pad => -pad.axes[2]];
const DEAD = 0.12;  // a gamepad's inexactness
const FASTEST = 1.5;  // how much the hardest push changes the robot's speed [m/s]

// An area whose knob follows the pointer; `moved` gets where it is, up and to the left, or null.
function pad(kind, moved) {
  const area = document.createElement("div"), knob = document.createElement("i");
  area.className = `pad ${kind}`;
  area.append(knob);
  area.put = (up, left) => {
    Object.assign(knob.style, {top: `${50 - 38 * up}%`, left: `${50 - 38 * left}%`});
  };
  const follow = event => {
    if (!area.hasPointerCapture(event.pointerId)) return;
    const box = area.getBoundingClientRect(), at = (p, size) => clip((1 - 2 * p / size) * 1.3);
    const up = kind === "slider" ? 0 : at(event.clientY - box.top, box.height);
    const left = at(event.clientX - box.left, box.width);
    area.put(up, left);
    moved([up, left]);
  };
  area.onpointerdown = event => { area.setPointerCapture(event.pointerId); follow(event); };
  area.onpointermove = follow;
  area.onlostpointercapture = () => { area.put(0, 0); moved(null); };
  area.put(0, 0);
  return area;
}

function interact(robot, view, hand) {
  const {about} = robot, down = new Set(), dragged = about.commands.map(() => 0);
  const show = (tag, text = "") => Object.assign(document.createElement(tag), {textContent: text});
  const state = {paused: false, pace: 1, rate: 1};

  // Each command beside what the robot does.
  const rows = (about.commands.length ? about.commands : about.speeds).map((command, i) => {
    const row = show("tr"), name = show("td", `${command.name} `), cells = [show("td"), show("td")];
    const keys = (about.commands.length ? KEYS[i] ?? [] : []).filter(k => k.startsWith("Key"));
    if (side(command, i) < 0) keys.reverse();  // what is more comes first
    name.append(...keys.map(key => show("kbd", key.slice(3))));
    row.append(name, ...cells);
    cells[0].hidden = !about.commands.length;
    document.querySelector("tbody").append(row);
    return {command, cells};
  });
  document.querySelector("table").hidden = !rows.length;
  $("commanded").hidden = !about.commands.length;

  const drive = $("drive"), draws = [];
  if (about.commands.length) {
    const stick = pad("stick", at => { [dragged[0], dragged[1]] = at ?? [0, 0]; });
    draws.push(tilt => stick.put(tilt[0], tilt[1] ?? 0));
    drive.append(stick);
  }
  about.commands.slice(2).forEach((command, i) => {
    const slider = pad("slider", at => { dragged[i + 2] = at ? at[1] : 0; });
    draws.push(tilt => slider.put(0, tilt[i + 2]));
    drive.append(slider);
  });
  const [first, second, ...others] = about.commands.map(c => c.name);
  const hint = [[first, second].filter(Boolean).join(", "), ...others].join(" · ");
  drive.append(Object.assign(show("div", hint), {className: "hint"}));

  const strongest = FASTEST * robot.mass;
  let aim = [0, 0];
  const target = pad("stick", at => {
    if (at) aim = at;
    else robot.push(...aim.map(v => v * strongest));
    const strength = Math.hypot(...aim) * strongest;
    $("push").lastChild.textContent = at ? `let go: ${strength.toPrecision(2)} N·s` : "drag, and let go";
  });
  $("push").append(show("b", "Push "), show("kbd", "P"), target,
                   Object.assign(show("div", "drag, and let go"), {className: "hint"}));
  const pushAnywhere = () => {
    const turn = 2 * Math.PI * Math.random();
    robot.push(0.4 * strongest * Math.cos(turn), 0.4 * strongest * Math.sin(turn));
  };

  const buttons = {
    Space: ["pause", button => { state.paused = !state.paused; press(button, state.paused); }],
    KeyL: ["slow", button => { state.pace = state.pace < 1 ? 1 : 0.25; press(button, state.pace < 1); }],
    KeyR: ["reset", () => robot.reset()],
    KeyP: ["", pushAnywhere],
    "": ["about", () => $("more").showModal()],
  };
  const press = (button, isOn) => button.setAttribute("aria-pressed", isOn);
  for (const [name, act] of Object.values(buttons))
    if (name) $(name).onclick = event => { act($(name)); event.currentTarget.blur(); };
  const used = new Set(KEYS.slice(0, about.commands.length).flat().filter(Boolean));
  addEventListener("keydown", event => {
    if (event.ctrlKey || event.altKey || event.metaKey || $("more").open) return;
    const [name, act] = (event.code && buttons[event.code]) || [];
    if (!act && !used.has(event.code)) return;
    event.preventDefault();
    if (!act) down.add(event.code);
    else if (!event.repeat) act(name && $(name));
  });
  addEventListener("keyup", event => down.delete(event.code));
  for (const kind of ["blur", "visibilitychange"]) addEventListener(kind, () => down.clear());

  function command() {
    const pads = [...navigator.getGamepads?.() ?? []].filter(each => each?.mapping === "standard");
    const tilt = about.commands.map((_, i) => {
      const [more, more2, less, less2] = (KEYS[i] ?? []).map(key => down.has(key));
      const tilted = pads.map(each => GAMEPAD[i]?.(each) ?? 0).filter(v => Math.abs(v) > DEAD);
      return clip(dragged[i] + (more || more2 || 0) - (less || less2 || 0)
                  + tilted.reduce((a, b) => a + b, 0));
    });
    draws.forEach(draw => draw(tilt));
    robot.commands = about.commands.map((command, i) => {
      const {rest, lowest, highest} = command, more = side(command, i) * tilt[i];
      return rest + more * (more > 0 ? highest - rest : rest - lowest);
    });
  }

  function report() {
    rows.forEach(({command: {unit, axis}, cells: [commanded, actual]}, i) => {
      commanded.textContent = robot.commands[i]?.toFixed(2);
      actual.textContent = axis === null ? unit : `${robot.done[axis].toFixed(2)} ${unit}`;
    });
    const status = robot.fallen ? "fallen: it stands up again soon" : `${robot.time.toFixed(1)} s · `
      + (state.paused ? "paused" : `${state.rate.toFixed(2)} × real time`);
    $("state").textContent = status;
    $("state").className = robot.fallen ? "bad" : "";
  }

  // Simulates what has become due since the picture before; a page that slept goes on from there.
  let before = performance.now(), due = 0;
  async function live(now) {
    const elapsed = Math.max(0, (now - before) / 1e3), start = robot.time;
    before = now;
    command();
    if (!state.paused) due += Math.min(elapsed, 0.25) * state.pace;
    for (const end = performance.now() + 120; due >= robot.timestep; due -= robot.timestep) {
      await robot.advance(hand.pull);
      if (performance.now() > end) due = 0;  // this machine is slower than the robot
      if (!robot.whole || robot.lying > LYING) robot.reset();
    }
    if (elapsed > 0) state.rate += 0.1 * (Math.max(0, robot.time - start) / elapsed - state.rate);
    hand.show();
    view.draw();
    report();
    requestAnimationFrame(moment => live(moment).catch(fail));
  }
  return live(before);
}

// ---- The start.

const fail = error => { say(`This page cannot go on: ${error.message ?? error}`); throw error; };

async function start() {
  const lacking = {
    WebAssembly: globalThis.WebAssembly, DecompressionStream: globalThis.DecompressionStream,
    WebGL: document.createElement("canvas").getContext("webgl2"),
  };
  for (const [name, found] of Object.entries(lacking))
    if (!found) return say(`This browser has no ${name}, which this page needs; take a newer one.`);
  const about = JSON.parse(await text("robot.json"));
  document.title = `Drive the ${about.name}`;
  $("facts").querySelector("h1").textContent = about.name;
  $("rate").textContent = Math.round(1 / about.period);
  $("origin").textContent = Object.entries(about.facts).map(([k, v]) => `${k} ${v}`).join(" · ");
  document.querySelector("dialog pre").textContent = await text("licences.txt");
  const core = await address("three.core.js");
  const scene = await address("three.module.js", {"./three.core.js": core});
  const controls = await address("OrbitControls.js", {three: scene});
  const [three, {OrbitControls}, {default: load}, ort] = await Promise.all(
    [scene, controls, await address("mujoco.js"), await address("ort.wasm.bundle.min.mjs")]
      .map(place => import(place)));
  const mujoco = await load({wasmBinary: await unpacked("mujoco.wasm"), locateFile: name => name});
  Object.assign(ort.env.wasm, {numThreads: 1, proxy: false,
                               wasmBinary: await unpacked("ort-wasm-simd-threaded.wasm")});
  const session = await ort.InferenceSession.create(await unpacked("policy.onnx"));
  const model = mujoco.MjModel.from_xml_string(await text("robot.xml"));
  const robot = new Robot(mujoco, model, ort, session, about);
  const view = new View(three, OrbitControls, robot);
  const hand = new Hand(view);
  // What tests and other programs may look at.
  globalThis.vgps = {
    get time() { return robot.time; }, get step() { return robot.step; },
    get position() { return [...robot.data.xpos.slice(3 * about.base, 3 * about.base + 3)]; },
    get heading() { return robot.heading; }, get fallen() { return robot.fallen; },
    get command() { return [...robot.commands]; }, get done() { return [...robot.done]; },
    get recent() { return structuredClone(robot.recent); },
  };
  for (const id of ["facts", "push", "tools"]) $(id).hidden = false;
  $("drive").hidden = !about.commands.length;
  say("");
  await interact(robot, view, hand);
}

start().catch(fail);
