# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Two arms under their weight: one of servos, whose order is not that of the joints; one geared."""

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


def write_arm(folder, mjcf):
    """Writes an arm and its task; returns the task's path."""
    (folder / "arm.xml").write_text(mjcf)
    (folder / "task.yaml").write_text(TASK)
    return str(folder / "task.yaml")
