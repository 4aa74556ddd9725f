# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Models of small robots of each kind, as MJCF."""

import re

GROUND = '<geom name="ground" type="plane" size="0 0 1"/>'
LEG = """
<body name="{name}_thigh" pos="{x} {y} 0">
  <joint name="{name}_roll" axis="1 0 0" range="-40 40"/>
  <joint name="{name}_hip" axis="0 1 0" range="-90 90"/>
  <geom type="capsule" size=".02" fromto="0 0 0 0 0 -.2" contype="0" conaffinity="0"/>
  <body name="{name}_shank" pos="0 0 -.2"><joint name="{name}_knee" axis="0 1 0" range="0 150"/>
    <geom type="capsule" size=".02" fromto="0 0 0 0 0 -.18" contype="0" conaffinity="0"/>
    <geom name="{name}_foot" size=".02" pos="0 0 -.2"/></body>
</body>"""


WEAKER = 'ctrlrange="-25 25"'  # than what would shake these legs


def walker(*legs, motor="motor", extra=WEAKER, joint='<freejoint name="base"/>', armature=0.05):
    """Returns a trunk on legs, each of which has a name and a place."""
    joints = [f"{name}_{part}" for name, *_ in legs for part in ("roll", "hip", "knee")]
    return f"""<mujoco><compiler autolimits="true"/><option timestep="0.002"/>
    <default><joint damping=".5" armature="{armature}"/></default>
    <worldbody>{GROUND}<body name="trunk" pos="0 0 .6">{joint}
      <geom name="trunk" type="box" size=".2 .1 .05" mass="5"/>
      {"".join(LEG.format(name=name, x=x, y=y) for name, x, y in legs)}</body></worldbody>
    <actuator>{"".join(f'<{motor} name="{j}" joint="{j}" {extra}/>' for j in joints)}</actuator>
    </mujoco>"""


def on_soles(servo):
    """Returns a walker on two legs, whose soles are held level by ankles."""
    return re.sub(
        r'<geom name="(\w+)_foot" size=".02" pos="0 0 -.2"/>',
        r'<body name="\1_sole" pos="0 0 -.2"><joint name="\1_ankle" axis="0 1 0" range="-60 60"/>'
        r'<geom name="\1_foot" type="box" size=".08 .06 .01"/></body>',
        walker(*TWO, motor="position", extra=servo),
    ).replace(
        "</actuator>",
        "".join(
            f'<position name="{n}_ankle" joint="{n}_ankle" {servo}/>' for n in ("left", "right")
        )
        + "</actuator>",
    )


PLANE = (
    '<joint name="x" type="slide" axis="1 0 0"/><joint name="z" type="slide" axis="0 0 1"/>'
    '<joint name="pitch" axis="0 1 0"/>'
)
TWO = (("left", 0, 0.1), ("right", 0, -0.1))
FOUR = (("FL", 0.2, 0.1), ("FR", 0.2, -0.1), ("HL", -0.2, 0.1), ("HR", -0.2, -0.1))
SERVO = 'kp="60" kv="1" forcerange="-30 30" ctrlrange="-2.6 2.6"'
LATE = 'biastype="affine" dyntype="filterexact" dynprm=".1" forcerange="-30 30"'
LINK = '<geom type="capsule" size=".02" fromto="0 0 0 0 0 .4"/>'
ACROBOT = f"""<mujoco><worldbody><body name="upper" pos="0 0 2">
  <joint name="shoulder" axis="0 1 0"/>
  {LINK}<body name="lower" pos="0 0 .4"><joint name="elbow" axis="0 1 0"/>{LINK}</body>
  </body></worldbody><option><flag contact="disable"/></option>
  <actuator><motor name="elbow" joint="elbow" ctrlrange="-2 2" ctrllimited="true"/></actuator>
  </mujoco>"""
ARM = ACROBOT.replace(
    "<actuator>", '<actuator><motor joint="shoulder" ctrlrange="-9 9" ctrllimited="true"/>'
)
WEAK = f"""<mujoco><worldbody><body pos="0 0 2"><joint name="swing" axis="0 1 0"/>{LINK}</body>
  </worldbody><actuator><motor joint="swing" ctrlrange="-.5 .5" ctrllimited="true"/></actuator>
  </mujoco>"""
SEGMENT = """<body pos="0 .1 0"><joint name="{0}" axis="0 0 1"/>
  <geom type="capsule" size=".01" fromto="0 0 0 0 .08 0"/>"""
FISH = f"""<mujoco><option density="1000"><flag gravity="disable"/></option><worldbody>
  <body name="head" pos="0 0 1"><freejoint name="root"/><geom type="ellipsoid" size=".02 .05 .02"/>
  {SEGMENT.format("neck")}{SEGMENT.format("tail")}</body></body></body>
  {{target}}</worldbody><actuator><position joint="neck" kp=".01"/><position joint="tail" kp=".01"/>
  </actuator></mujoco>"""
SPINNER = ARM.replace(
    "</worldbody>",
    '<body name="top" pos=".5 0 2"><joint name="spin" axis="0 1 0"/><geom size=".1"/></body>'
    "</worldbody>",
)
CUP = """<mujoco><worldbody><body name="cup" pos="0 0 1">
  <joint name="cup" type="slide" axis="0 0 1" stiffness="20" damping="3"/>
  <geom type="box" size=".1 .1 .01"/>
  <site name="target" pos="0 0 .1"/></body>
  <body name="ball" pos="0 0 1.2"><joint name="fall" type="slide" axis="0 0 1"/>
  <geom size=".03"/></body>
  </worldbody><actuator><motor joint="cup" ctrlrange="-9 9" ctrllimited="true"/>
  </actuator></mujoco>"""

ROTOR = '<site name="{0}{1}" pos="{0}.1 {1}.1 0"/>'
DRONE = f"""<mujoco><worldbody>{GROUND}<body name="drone" pos="0 0 1"><freejoint name="base"/>
  <geom type="box" size=".1 .1 .02" mass="1"/>
  {"".join(ROTOR.format(x, y) for x in "-+" for y in "-+")}</body></worldbody><actuator>
  {
    "".join(
        f'<motor site="{x}{y}" gear="0 0 2 0 0 0" ctrllimited="true" ctrlrange="0 9"/>'
        for x in "-+"
        for y in "-+"
    )
}</actuator></mujoco>"""
CART = """<mujoco><worldbody><geom type="plane" size="1 1 1"/>
  <body name="cart" pos="0 0 .1"><freejoint/><geom type="box" size=".2 .1 .05"/>
    <body name="wheel" pos=".2 0 -.05"><joint name="wheel" axis="0 1 0"/><geom size=".05"/></body>
  </body></worldbody><actuator><motor joint="wheel" ctrllimited="true" ctrlrange="-1 1"/></actuator>
  </mujoco>"""
FINGER = """<body pos="{0} 0 1"><joint name="f{0}_1" axis="0 1 0" range="0 90"/>{1}
  <body pos="0 0 .4"><joint name="f{0}_2" axis="0 1 0" range="0 90"/>{1}</body></body>"""
BAR = '<body name="{0}" pos="{1} 0 2"><joint name="{0}" axis="0 1 0"/>{2}{3}</body>'
COUPLER = BAR.format("coupler", 0, LINK, "")
FOUR_BARS = f"""<mujoco><worldbody>{BAR.format("crank", 0, LINK, COUPLER)}
  {BAR.format("rocker", 0.3, LINK, "")}</worldbody>
  <equality><connect body1="coupler" body2="rocker" anchor="0 0 .4"/></equality>
  <actuator><motor joint="crank" ctrlrange="-90 90" ctrllimited="true"/></actuator></mujoco>"""
HAND = f"""<mujoco><compiler autolimits="true"/><worldbody>
  {"".join(FINGER.format(x, LINK) for x in range(3))}</worldbody><actuator>
  {"".join(f'<motor joint="f{x}_{i}" ctrlrange="-9 9"/>' for x in range(3) for i in (1, 2))}
  </actuator></mujoco>"""

CUBE = '<body name="cube" pos=".4 .3 1"><freejoint/><geom type="box" size=".04 .04 .04"/></body>'
BOLTED = "".join(
    f'<joint name="b{a}" type="slide" axis="{v}" damping="1e11"/>'
    for a, v in (("x", "1 0 0"), ("y", "0 1 0"), ("z", "0 0 1"))
)
MOUSE = '<body name="mouse" mocap="true" pos=".5 0 2"><geom size=".02" contype="0"/></body>'
HELD = ARM.replace("</worldbody>", f"{MOUSE}</worldbody>").replace(
    "</mujoco>", '<equality><weld body1="mouse" body2="lower"/></equality></mujoco>'
)

HEAD = """<body name="torso_head" pos="0 {y} .1"><joint name="torso_head" axis="0 1 0"/>
<geom size=".04" mass=".2"/></body>"""

SIX = ("0 0 1", "0 1 0", "0 1 0", "0 1 0", "0 0 1", "0 1 0")  # axes, as of a UR5

SIX_JOINTS = f"""<mujoco><worldbody>{
    "".join(
        f'<body pos="0 0 {length if i else 0.2}"><joint name="j{i}" axis="{axis}"/>'
        f'<geom type="capsule" size=".03" fromto="0 0 0 0 0 {length}"/>'
        for i, (axis, length) in enumerate(zip(SIX, (0.1, 0.4, 0.4, 0.1, 0.1, 0.1), strict=True))
    )
}<site name="tool" pos="0 0 .1"/>{"</body>" * 6}</worldbody>
<option><flag contact="disable"/></option><actuator>{
    "".join(f'<position joint="j{i}" kp="900" kv="90"/>' for i in range(6))
}</actuator></mujoco>"""

BALL = '<body name="{0}" pos="2 0 .1"><freejoint/><geom size=".1"/><site name="{0}"/></body>'
