"""What was measured: raw logs to typed SI streams, to MCAP and back. Knows no vehicle model.

Conventions, on one page
------------------------
Units       SI everywhere (m, s, rad, kg, N, Pa, T); anything else carries its unit as a suffix.
Body frame  x forward, y left, z up, origin at the body's centre of mass (REP 103).
World       local East-North-Up tangent plane at an origin (lat, lon in degrees, ellipsoidal alt in m).
Yaw         counter-clockwise from East, continuous (unwrapped).
Path frame  s along the AB line in the direction of travel, n to its left.
Mounting    a sensor's axes are the body's axes turned by R = Rz(yaw)·Ry(pitch)·Rx(roll): v_body = R·v_sensor.
Wheel unit  turns about its axle; phase and spin are positive about +y (rolling forward); at phase 0 its
            frame is parallel to the wheel's frame.
Inertial    accelerometers read specific force: +9.81 on z at rest. g = 9.80665 m/s².
Time        `t` is the instant of measurement, UTC seconds since the epoch (float64, resolution 0.24 µs);
            `t_arrival` is when the logger received the sample, on the same UTC scale.
"""
