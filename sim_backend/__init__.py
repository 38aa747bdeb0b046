"""PLACEHOLDER"""

if __name__ != "toolee_robot.sim_backend":
    raise ImportError("import toolee_robot.sim_backend: the short name would make a second copy of every module")
