"""On the robot: sources of frames as they come, answers as messages, logs that replay."""
