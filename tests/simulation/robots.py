# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""A robot that has everything: a free base on a floor, a ball, activations, a tendon, sensors."""

import mujoco
import numpy as np

EVERYTHING = """
<mujoco>
  <option timestep="0.002" integrator="implicitfast" tolerance="1e-12"/>
  <default>
    <geom solref="0.04 1" solimp="0 0.95 0.02 0.5 2"/>
  </default>
  <worldbody>
    <geom name="floor" type="plane" size="5 5 .1"/>
    <body name="base" pos="0 0 0.3">
      <freejoint name="base"/>
      <geom name="trunk" type="box" size=".2 .1 .05" mass="3"/>
      <site name="imu" pos=".05 0 .02" euler="10 20 30"/>
      <body name="thigh" pos=".15 0 0">
        <joint name="hip" axis="0 1 0" damping=".2" armature=".01"/>
        <geom type="capsule" fromto="0 0 0 .05 0 -.15" size=".02" mass=".4"/>
        <body name="shin" pos=".05 0 -.15">
          <joint name="knee" axis="0 1 0" damping=".2" armature=".01"/>
          <geom name="foot" type="capsule" fromto="0 0 0 -.05 0 -.14" size=".02" mass=".2"/>
          <site name="foot" pos="-.05 0 -.14" size=".03"/>
        </body>
      </body>
      <body name="tail" pos="-.2 0 0">
        <joint name="tail" type="ball" damping=".1" armature=".01"/>
        <geom type="capsule" fromto="0 0 0 -.2 0 0" size=".02" mass=".2"/>
      </body>
    </body>
  </worldbody>
  <tendon>
    <fixed name="both"><joint joint="hip" coef="1"/><joint joint="knee" coef="-.5"/></fixed>
  </tendon>
  <actuator>
    <motor name="hip" joint="hip"/>
    <general name="slow_knee" joint="knee" dyntype="filter" dynprm=".05" gainprm="2"/>
    <position name="pull" tendon="both" kp="3"/>
    <motor name="wag" joint="tail" gear="0 1 .5"/>
  </actuator>
  <sensor>
    <subtreelinvel name="velocity" body="base"/>
    <subtreecom name="centre" body="base"/>
    <subtreeangmom name="spin" body="base"/>
    <framepos name="foot_in_base" objtype="site" objname="foot" reftype="body" refname="base"/>
    <framezaxis name="up" objtype="xbody" objname="tail" reftype="site" refname="imu"/>
    <framequat name="attitude" objtype="body" objname="base"/>
    <framelinvel name="foot_velocity" objtype="site" objname="foot"/>
    <gyro name="gyro" site="imu"/>
    <velocimeter name="speed" site="imu"/>
    <jointpos name="hip_angle" joint="hip"/>
    <ballangvel name="wagging" joint="tail"/>
    <tendonpos name="length" tendon="both"/>
    <accelerometer name="acceleration" site="imu"/>
    <touch name="load" site="foot"/>
    <actuatorfrc name="effort" actuator="slow_knee"/>
  </sensor>
  <keyframe>
    <key name="stand" qpos="0 0 .27 1 0 0 0 0.1 0.2 1 0 0 0"/>
  </keyframe>
</mujoco>
"""


def everything() -> mujoco.MjModel:
    return mujoco.MjModel.from_xml_string(EVERYTHING)


def random_states(model: mujoco.MjModel, rng: np.random.Generator, count: int) -> np.ndarray:
    """Returns states in all orientations, some with the foot in the floor, shape (count, n_x)."""
    states = []
    for _ in range(count):
        qpos = model.qpos0.copy()
        mujoco.mj_integratePos(model, qpos, rng.uniform(-0.5, 0.5, model.nv), 1.0)
        qpos[2] = rng.uniform(0.25, 0.35)
        states.append(np.r_[qpos, rng.uniform(-1, 1, model.nv), rng.uniform(-1, 1, model.na)])
    return np.array(states)
