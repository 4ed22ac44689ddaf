"""The loopback robot: it speaks the robot's protocols, moves a chosen body, takes camera frames, and fails on request.

    bodies                                    the moving bodies, behind one interface
    virtual_body, ticked_body, engine_bodies  the second robot; MuJoCo, compiled code, the flow solver
    firmware                                  the microcontroller: datagrams, watchdog, telemetry
    faults, network_faults, robot_faults      possible faults, each by name and time
    camera, camera_frames, shared_frames      timing of frames, their content, their transfer to another process
    robot, settings                           all of it on one clock; its settings
    server, command                           in real time behind UDP on 127.0.0.1
    lockstep                                  in the host's own process, faster than real time

Nothing here listens on another address than 127.0.0.1.
"""
