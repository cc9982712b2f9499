"""The stiffness paper: a gripper, extreme learning machines, and the hardness cubes."""
