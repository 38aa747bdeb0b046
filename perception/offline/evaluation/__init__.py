"""Evaluation of the perception: metrics, tables, pictures and the report.

`toolee evaluate pose|segmentation|photographs DIR` runs it; docs/results/protocol.md defines every figure.
"""
