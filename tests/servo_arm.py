# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Arms under their weight: one of servos, in another order than the joints; two geared ones."""

SERVOS = """
<mujoco model="servo_arm">
  <compiler angle="radian"/>
  <option timestep="0.004"/>
  <worldbody>
    <body name="upper" pos="0 0 1">
      <joint name="shoulder" axis="0 1 0" damping="1"/>
      <geom type="capsule" size=".03" fromto="0 0 0 .4 0 0" mass="1"/>
      <body name="fore" pos=".4 0 0">
        <joint name="elbow" axis="0 1 0" damping="1"/>
        <geom type="capsule" size=".02" fromto="0 0 0 .3 0 0" mass=".5"/>
      </body>
    </body>
  </worldbody>
  <actuator>
    <position name="second" joint="elbow" kp="60"/>
    <position name="first" joint="shoulder" kp="120"/>
  </actuator>
  <keyframe><key name="home" qpos="-.7 .5" ctrl=".5 -.73"/></keyframe>
</mujoco>
"""
GEARED = """
<mujoco model="geared_arm">
  <option timestep="0.004"/>
  <worldbody>
    <body name="upper" pos="0 0 1">
      <joint name="shoulder" axis="0 1 0" damping=".5"/>
      <geom type="capsule" size=".03" fromto="0 0 0 .4 0 0" mass="1"/>
    </body>
  </worldbody>
  <actuator><motor name="motor" joint="shoulder" gear="50" ctrlrange="-1 1"/></actuator>
  <keyframe><key name="home" qpos="-.7"/></keyframe>
</mujoco>
"""
# Light, so that a stiff loop held for a control period does not rest.
LEG = """
<mujoco model="leg">
  <compiler angle="radian"/>
  <option timestep="0.005" integrator="implicitfast"/>
  <worldbody>
    <body name="thigh" pos="0 0 1">
      <joint name="shoulder" axis="0 1 0" armature=".005"/>
      <geom type="capsule" size=".02" fromto="0 0 0 0 0 -.2" mass=".3"/>
      <body name="shin" pos="0 0 -.2">
        <joint name="elbow" axis="0 1 0" armature=".005"/>
        <geom type="capsule" size=".015" fromto="0 0 0 0 0 -.2" mass=".15"/>
      </body>
    </body>
  </worldbody>
  <actuator>
    <motor name="first" joint="shoulder" gear="6" ctrlrange="-4 4"/>
    <motor name="second" joint="elbow" gear="-6" forcerange="-3 4"/>
  </actuator>
  <keyframe><key name="home" qpos="-.7 .5"/></keyframe>
</mujoco>
"""
TASK = """
model: arm.xml
control_period: 0.02
horizon: 0.4
start: {keyframe: home}
cost:
  - {sensor: shoulder/position, target: -0.7, weight: 10.0}
  - {control: all, weight: 1.0e-3}
observe: [joint_positions, joint_velocities]
search: {hidden_units: [4], iterations: 2, evaluation_rollouts: 2}
"""
REMEMBERING = """
model: arm.xml
control_period: 0.02
horizon: 1.0
start: {keyframe: home}
clock: {frequency: 2.0}
cost: [{control: all, weight: 1.0}]
observe: [joint_positions, last_action, clock, joint_velocities]
history: 2
"""


def write_arm(folder, mjcf=SERVOS, task=TASK):
    """Writes an arm and its task; returns the task's path."""
    (folder / "arm.xml").write_text(mjcf)
    (folder / "task.yaml").write_text(task)
    return str(folder / "task.yaml")
