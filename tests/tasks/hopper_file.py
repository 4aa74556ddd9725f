# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""A small hopper and its task file, as a user would write them."""

HOPPER = """
<mujoco model="hopper">
  <worldbody>
    <geom name="floor" type="plane" size="0 0 1"/>
    <body name="torso" pos="0 0 1.2">
      <joint name="root_x" type="slide" axis="1 0 0"/>
      <joint name="root_z" type="slide" axis="0 0 1"/>
      <joint name="pitch" type="hinge" axis="0 1 0"/>
      <geom name="torso" type="capsule" size="0.05 0.2"/>
      <body name="leg" pos="0 0 -0.2">
        <joint name="hip" type="hinge" axis="0 1 0" range="-60 60"/>
        <geom name="shin" type="capsule" fromto="0 0 0 0 0 -0.9" size="0.04"/>
        <geom name="left_foot" type="sphere" pos="0 0 -0.9" size="0.06"/>
      </body>
    </body>
  </worldbody>
  <actuator><motor name="hip_motor" joint="hip" ctrllimited="true" ctrlrange="-1 1"/></actuator>
  <sensor><subtreecom name="com" body="torso"/></sensor>
  <keyframe><key name="stand" qpos="0 0 0 0.1" ctrl="0.5"/></keyframe>
</mujoco>
"""

TASK = """\
model: hopper.xml
changes:
  option: {timestep: 0.005, integrator: implicitfast, tolerance: 1e-12, gravity: [0, 0, -9.81]}
  joints:
    "*": {damping: 0, armature: 0}
    hip: {damping: 1, armature: 0.02, range: [-1, 1]}
  geoms:
    "*foot": {solref: [0.04, 1], solimp: [0, 0.95, 0.02, 0.5, 2], friction: 1, condim: 3}
  remove_actuators: ["*"]
  actuators:
    hip: {joint: hip, limit: 24}
  only_contacts: [["floor", "*foot"]]
control_period: 0.01
horizon: 4.0
lookahead: 0.6
start:
  keyframe: stand
  positions: {hip: 0.2}
  std: {position: 0.01, velocity: 0.1, overrides: {root_x/position: 0.0}}
sensors:
  velocity: {type: subtreelinvel, body: torso}
  height: {type: framepos, body: torso}
  up: {type: framezaxis, body: world, relative_to: {xbody: torso}}
cost:
  - {sensor: velocity, index: x, target: 1.0, weight: 1.0}
  - {sensor: height, index: z, target: 1.2, weight: 5.0, norm: smooth_abs, width: 0.2}
  - {sensor: com/z, target: 3.0}
  - {control: all, weight: 1.0e-4}
observe:
  - {joint_positions: {except: [root_x]}}
  - joint_velocities
  - {joint: hip, as: sin_cos}
  - {sensor: up}
fallen:
  - {sensor: height, index: z, below: 0.7}
  - {sensor: pitch/position, beyond: 1.0}
marginals: {std_limit: {position: 0.3, velocity: 4.0, overrides: {root_x/position: .inf}}}
begin: {law: pd, pose: stand, stiffness: 300, damping: {"*": 30}}
optimizer: {ddp.regularization_floor: 0.1, marginals: {std_limit_annealing: 0.5}}
search: {hidden_units: [10], fit: {iterations: 50}}
"""
