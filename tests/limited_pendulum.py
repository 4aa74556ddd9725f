# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""A pendulum whose motor pulls more to one side than to the other, and cannot hold it up."""

PENDULUM = """
<mujoco model="pendulum">
  <option timestep="0.01" integrator="implicitfast"/>
  <worldbody>
    <body name="rod">
      <joint name="hinge" axis="0 1 0" damping="0.05"/>
      <geom name="rod" type="capsule" fromto="0 0 0 0 0 -1" size="0.05" mass="1"/>
      <site name="tip" pos="0 0 -1"/>
    </body>
  </worldbody>
  <actuator><motor name="motor" joint="hinge" gear="2" forcerange="-0.5 1.5"/></actuator>
  <sensor><framepos name="tip" objtype="site" objname="tip"/></sensor>
  <keyframe><key name="side" qpos="1.5"/><key name="up" qpos="3.0"/></keyframe>
</mujoco>
"""
LOW, HIGH = -0.5, 1.5

TASK = """
model: pendulum.xml
control_period: 0.02
horizon: 1.0
start: {std: {position: 0.05, velocity: 0.05}}
cost:
  - {sensor: hinge/position, target: 1.5, weight: 100.0}
  - {control: all, weight: 1.0e-3}
search: {hidden_units: [5], iterations: 3, evaluation_rollouts: 4}
"""


def write_task(folder, *changes):
    """Writes the pendulum and its task, with some lines changed; returns the task's path."""
    text = TASK
    for old, new in changes:
        assert old in text
        text = text.replace(old, new)
    (folder / "pendulum.xml").write_text(PENDULUM)
    (folder / "task.yaml").write_text(text)
    return str(folder / "task.yaml")
