"""The loopback robot: it speaks the robot's protocols, moves a body of choice, takes camera frames, and fails when it is told to.

    bodies                                    what moves, behind one interface
    virtual_body, ticked_body, engine_bodies  the second robot; MuJoCo, compiled code, the flow solver
    firmware                                  the microcontroller: datagrams, watchdog, telemetry
    faults, network_faults, robot_faults      what can go wrong, each by name and time
    camera, camera_frames, shared_frames      when frames are taken, what is on them, how another process gets them
    robot, settings                           all of it on one clock; what it is made of
    server, command                           in real time behind UDP on 127.0.0.1
    lockstep                                  in the host's own process, faster than real time

Nothing here listens on another address than 127.0.0.1.
"""
