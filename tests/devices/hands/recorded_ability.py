"""Bytes that PSYONIC recorded from its hands, for its own tests.

From python/tests/test_mock_data.py of github.com/psyonicinc/ability-hand-api (MIT licence, Copyright (c) 2024 PSYONIC,
Inc.): replies of variant 2 over an RS-485 adapter that puts zeros between the frames, in the pieces in which they came.
"""

PIECES = (
    b'\x00~\x111"\xe5\xff\x84\x08&\x005"\xfe\xff\x8a\x08\xf9\xff\x9b\x19\x12\x00o\xe6\x10\x00\x8aP\t\xbc\xb02f\xa0\rb&"|'
    b"\x10\x1e\xc8\x91^\xbd\x96,\x9b@K\x94q*\xf2A\x0c\xa6 \\\xf1!\x17\xa3\xa0\x0b\x88DNL\xf1\x15\x00F~\x00",
    b'\x00~\x111"(\x00\x85\x08C\x005"\xde\xff\x8a\x08\xf9\xff\x9b\x19\x12\x00`\xe6\x10\x00\x8d\x10\t\xb8`3i0\x0ed\x96"}]@'
    b"\x1e\xcaQ^\xbd\x96,\x9b@K\x94q*\xf2A\x0c\xa6 \\\xf1!\x17\xa3\xa0\x0b\x88DNL\xf1\x15\x00\xaa~\x00",
    b"\x00|\xc2",
    b'\xff\xff5"\xff\xff\x8a\x08\xfe\xff\x9b\x19\xe3\xffc\xe6\xe3\xff\x8b0\t\xb7P3e\xb0\rd\x96"}]@\x1e\xcaQ^\xbf\xa6,\x9cPK'
    b"\x94\x91*\xf2A\x0c\xa6 \\\xf1!\x17\xa6 \x0c\x8e\x84NRq\x16\x00\x17~\x00",
    b'\x00~\x111"\x19\x00\x85\x08\xff\xff5"\xff\xff\x8a\x08\xfd\xff\x9b\x19\x0c\x00f\xe6\xd6\xff\x8b0\t\xb7P3e\xb0\rd\x96"}]@'
    b"\x1e\xcaQ^\xbf\xa6,\x9cPK\x94\x91*\xf7q\x0c\xa8p\\\xf3a\x17\xa6 \x0c\x8e\x84NRq\x16\x00/~\x00",
)  # fmt: skip
WHOLE = (0, 1, 4)
"""Pieces with a whole frame; that of the others has lost its beginning."""
POSITIONS = (40.07, 9.98, 40.09, 10.01, 30.01, -29.96)
"""Positions in the first frame [deg], by the unit of the Interface Control Document."""
PADS = (
    138, 149, 188, 811, 102, 218, 1634, 546, 124, 481, 456, 1513, 1725, 713, 155, 1204, 404, 679, 498, 196, 166, 1474,
    497, 370, 163, 186, 1160, 1252, 332, 351,
)  # fmt: skip
"""Touch pads in the first frame, unpacked by hand after section 3.4.6 of that document."""
