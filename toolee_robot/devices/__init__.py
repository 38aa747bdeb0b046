"""Drivers of real devices behind `toolee_robot.hal`."""
