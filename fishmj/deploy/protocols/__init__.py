"""Protocols of the wires, as pure bytes <-> values. No sockets, no serial ports, no clocks.

    messages       messages between host and robot, in SI units
    fishmj1        this project's own datagram: numbered, stamped, CRC-32, watchdog times, battery, faults
    sequence       decides which of the numbered datagrams are new
    mish           the open robot's UDP layout as published, with its firmware's conversion of angles
    lx_bus         frames of LX-series bus servos
    dynamixel      packets of Dynamixel servos, protocols 2.0 and 1.0
    frame_reader   finds the frames of either in a half-duplex byte stream
    servo_bus      servo buses behind one interface: questions, answers, commands
    servo_counts   counts <-> rad, offsets
    watchdog       the robot firmware's watchdog, as a reference for the C code in `firmware/`
    firmware_guard the faults that the robot's firmware finds and reports, likewise
    policy_header  a policy as a C header

Byte tables: docs/tank/protocols.md. NumPy and the standard library only.
"""

SERVO_BUS = "servo-bus"  # no microcontroller: the host speaks to the servos themselves
PROTOCOLS = ("fishmj-1", "mish-0.1.0", "mish-fixed", SERVO_BUS)
