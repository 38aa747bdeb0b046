"""How good the perception is, measured: the metrics, the tables, the pictures and the report.

`toolee evaluate pose|segmentation|samplers DIR` is the way in; docs/results/protocol.md defines every figure.
"""
