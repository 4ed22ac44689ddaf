"""Links to a robot: transports, servo buses, ROS 2, MCAP."""
