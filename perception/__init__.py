"""PLACEHOLDER"""

if __name__ != "toolee_robot.perception":
    raise ImportError("import toolee_robot.perception: the short name would make a second copy of every module")
