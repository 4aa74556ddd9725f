// Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
// The robot of the page: MuJoCo simulates it, and its policy, an ONNX file, drives it. What the policy
// reads is described by page.py, `about`; lengths are in metres, and z points up. The page's three
// programs, robot.js, view.js and page.js, stand one after another in one module.

// What MuJoCo computes before readings are taken: nothing, poses and velocities, or everything.
const COMPUTED = [[], ["mj_kinematics", "mj_comPos", "mj_sensorPos", "mj_comVel", "mj_subtreeVel",
                       "mj_sensorVel"], ["mj_forward"]];
const PUSH_TIME = 0.1, LYING = 2;  // how long a push lasts, and a fallen robot lies [s]
const RECENT = 200;  // steps that window.vgps.recent holds
const SMOOTH = 0.4;  // time over which speeds are averaged [s]

class Robot {
  constructor(mujoco, model, ort, session, about) {
    Object.assign(this, {mujoco, model, ort, session, about});
    model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_AUTORESET.value;
    this.data = new mujoco.MjData(model);
    this.timestep = about.period / about.substeps;
    this.mass = model.body_subtreemass[0];
    this.commands = about.commands.map(c => c.rest);
    this.reset();
  }

  reset() {
    const {mujoco, model, data, about} = this;
    mujoco.mj_resetData(model, data);
    data.qpos.set(about.state.slice(0, model.nq));
    data.qvel.set(about.state.slice(model.nq, model.nq + model.nv));
    data.act?.set(about.state.slice(model.nq + model.nv));
    mujoco.mj_forward(model, data);
    Object.assign(this, {step: 0, awake: 0, substep: 0, time: 0, lying: 0, pushed: 0, frames: null, place: null,
                         action: about.first_action, done: [0, 0, 0], recent: []});
  }

  get fallen() { return this.lying > 0; }
  get whole() { return this.data.qpos.every(Number.isFinite); }

  // Numbers of the state: a coordinate, its sine or cosine, a sensor's number, or a quaternion's.
  read({kinds, places}) {
    const {qpos, qvel, act, sensordata} = this.data, state = [...qpos, ...qvel, ...(act ?? [])];
    return kinds.map((kind, i) => {
      if (kind === 3) return sensordata[places[i]];
      const x = state[places[i]];
      return kind === 1 ? Math.sin(x) : kind === 2 ? Math.cos(x) : x;
    });
  }

  // Whether the clock turns in this step. One that stops does where something is commanded, and for a
  // while after the base was tilted, or turned about a level axis.
  turns() {
    const {about: {unrest, commands}, data: {qpos, qvel}} = this;
    if (!unrest) return true;
    const state = [...qpos, ...qvel], [w, x, y, z] = state.slice(unrest.rotation, unrest.rotation + 4);
    const up = [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)];
    const rate = state.slice(unrest.rate, unrest.rate + 3), dot = (a, b) => a.reduce((sum, v, i) => sum + v * b[i], 0);
    const along = dot(rate, up), level = rate.map((v, i) => v - along * up[i]);
    if (dot(up, unrest.up) < Math.cos(unrest.tilt) || dot(level, level) > unrest.fastest ** 2)
      this.awake = this.step + unrest.steps;
    return this.step < this.awake || this.commands.some((v, i) => v !== commands[i].rest);
  }

  // Everything that the policy reads of this step: readings, memory, commands and clock.
  observe() {
    const {about} = this, now = this.read(about.readings);
    this.frames ??= Array(about.history).fill(now);
    const turned = 2 * Math.PI * (about.frequency * about.period * this.step % 1), turns = this.turns();
    const context = [...this.commands, turns ? Math.sin(turned) : 0, turns ? Math.cos(turned) : 0];
    const seen = [now, ...this.frames, this.action.slice(0, about.first_action.length),
                  about.context.map(i => context[i])].flat();
    this.frames = [now, ...this.frames].slice(0, about.history);
    return seen;
  }

  async act() {
    const {about, data, mujoco, model} = this;
    for (const name of COMPUTED[Math.max(about.readings.needs, about.fallen.needs)])
      mujoco[name](model, data);
    this.measure();
    const {lowest, highest} = about.fallen;
    const lies = this.read(about.fallen).some(
      (v, i) => v < (lowest[i] ?? -Infinity) || v > (highest[i] ?? Infinity));
    this.lying = lies ? this.lying + about.period : 0;
    const seen = this.observe(), array = about.precision === "float64" ? Float64Array : Float32Array;
    const input = new this.ort.Tensor(about.precision, array.from(seen), [1, seen.length]);
    const {actions} = await this.session.run({obs: input}, ["actions"]);
    this.action = Array.from(actions.data);
    data.ctrl.set(this.action.map((a, i) => a + about.origin[i]));
    data.qacc_warmstart.fill(0);  // nothing carries over from one control to the next
    this.recent.push({step: this.step, command: this.commands, observation: seen,
                      control: Array.from(data.ctrl)});
    this.recent.splice(0, this.recent.length - RECENT);
    this.step += 1;
  }

  // Simulates one step of MuJoCo, with a control before it where one is due.
  async advance(pull) {
    if (this.substep === 0) await this.act();
    const {data, model, mujoco, about} = this, applied = data.xfrc_applied;
    if (this.pushed > 0) {
      this.pushed -= this.timestep;
      this.force.forEach((f, i) => { applied[6 * about.pushed + i] += f; });
    }
    pull?.(applied);
    mujoco.mj_step(model, data);
    data.xfrc_applied.fill(0);  // readings are those without a push
    this.substep = (this.substep + 1) % about.substeps;
    this.time += this.timestep;
  }

  get heading() {
    const turn = this.data.xmat.subarray(9 * this.about.base);
    return Math.atan2(turn[3], turn[0]);
  }

  // Pushes by a change of momentum [N·s], ahead and to the left of the robot.
  push(ahead, left) {
    const c = Math.cos(this.heading) / PUSH_TIME, s = Math.sin(this.heading) / PUSH_TIME;
    this.force = [c * ahead - s * left, s * ahead + c * left, 0];
    this.pushed = PUSH_TIME;
  }

  // Averages how fast the base goes ahead and to the left [m/s], and turns to the left [rad/s].
  measure() {
    const {about, place} = this, heading = this.heading;
    const [x, y] = this.data.xpos.subarray(3 * about.base), period = about.period;
    this.place = [x, y, heading];
    if (!place) return;
    const [dx, dy] = [x - place[0], y - place[1]], turn = heading - place[2];
    const c = Math.cos(heading), s = Math.sin(heading);
    const now = [c * dx + s * dy, c * dy - s * dx, Math.atan2(Math.sin(turn), Math.cos(turn))];
    this.done = this.done.map((v, i) => v + (now[i] / period - v) * Math.min(1, period / SMOOTH));
  }
}
