"""PLACEHOLDER"""

if __name__ != "toolee_robot.control":
    raise ImportError("import toolee_robot.control: the short name would make a second copy of every module")
