"""The dumbbells of Machines 2022, section 4.2, at the start of Table 6, in the words of a case."""

SANDWICH = """\
[parts.bodies]
cells = ["head_1", "neck_1", "neck_2", "head_2"]
E = "130 GPa"
nu = 0.27
rho = "7850 kg/m3"
[joints.joint]
cells = ["joint"]
law = "transition"
E = "35 GPa"
nu = 0.27
h = "20 mm"
"""
