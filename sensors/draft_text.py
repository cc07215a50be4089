"""The parts of a drafted run.toml that no recording tells: typical values, to be measured."""

HEAD = """# Drafted from the raw files. Lengths, masses and positions are typical values: measure yours.
schema = 1

[run]
id = "{id}"
field = "field1"
direction = "east"
repeat = 1
variant = "a"
date = {date}

[operating]
speed = 2.5
tyre_pressure_mpa = 0.12
"""

MACHINE = """[machine.tractor]
mass = 5200.0
yaw_inertia = 9500.0
front_track = 1.90
rear_track = 1.80
front_axle = 1.45
rear_axle = 1.15
hitch = 2.05
cog_height = 1.0
front_wheel_radius = 0.62
rear_wheel_radius = 0.80

[machine.tyres.front]
cornering_stiffness = 6.0e4
friction = 0.6
rolling_resistance = 0.08

[machine.tyres.rear]
cornering_stiffness = 9.0e4
friction = 0.6
rolling_resistance = 0.08
"""

SEEDER = """[machine.seeder]
mass = 3300.0
yaw_inertia = 5200.0
hitch_to_com = 3.0
com_to_axle = 0.35
track = 3.60
cog_height = 0.9
wheel_radius = 0.50
draft = 9000.0

[machine.tyres.seeder]
cornering_stiffness = 5.0e4
friction = 0.6
rolling_resistance = 0.08
"""
