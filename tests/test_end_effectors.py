"""The records of the categories fit together, and with what data sets and weights were made with."""

from __future__ import annotations

import numpy as np
import pytest

from toolee_robot.end_effectors import CATEGORIES, END_EFFECTORS, Category, label_of
from toolee_robot.frames import is_rigid, transform
from toolee_robot.perception.detection.detector import CLASSES
from toolee_robot.tools import TOOL_SPECS, make_tool


def test_class_ids_count_from_one_in_the_order_of_the_names() -> None:
    assert tuple(Category) == CATEGORIES
    assert [category.spec.class_id for category in Category] == list(range(1, len(Category) + 1))
    assert [CLASSES[category.spec.class_id] for category in Category] == [str(category) for category in Category]


def test_the_ids_of_data_sets_and_weights_stay_what_they_are() -> None:
    assert [str(category) for category in CATEGORIES[:4]] == [
        "hammer_head", "hammer_grip", "screwdriver_head", "wrench_head",
    ]  # fmt: skip


def test_records_are_complete_and_tell_the_categories_apart() -> None:
    specs = END_EFFECTORS.values()
    assert sum(spec.training_share for spec in specs) == pytest.approx(1.0)
    for spec in specs:
        assert is_rigid(transform(spec.R_tool_ee))
        assert spec.radius > 0
        assert spec.frame.startswith("origin")
    for values in ([spec.label for spec in specs], [spec.color for spec in specs]):
        assert len(set(values)) == len(values)


def test_every_category_is_an_end_of_some_kind_of_tool_and_its_spin_cues_are_parts_of_it() -> None:
    for category in Category:
        kinds = [kind for kind, spec in TOOL_SPECS.items() if category in spec.end_effectors]
        assert kinds
        labels = {part.label for kind in kinds for seed in range(6) for part in make_tool(kind, seed).parts}
        assert set(category.spec.spin_cues) <= labels


def test_labels_are_for_people() -> None:
    assert label_of("hammer_grip") == "claw"
    assert label_of("class_average") == "class average"


def test_axes_cannot_be_changed() -> None:
    with pytest.raises(ValueError, match="read-only"):
        Category.HAMMER_HEAD.spec.R_tool_ee[0, 0] = 1.0
    np.testing.assert_array_equal(Category.SCREWDRIVER_HEAD.spec.R_tool_ee, np.eye(3))
