import json
from typing import Any

import pytest

from needle_rig.control.ranges import FASTEST_DEG_S, MOST_DEG, SLOWEST_DEG_S
from needle_rig.control.ranges import MOST_MOTIONS as STEPS
from needle_rig.errors import BadInput
from needle_rig.service.api.orders import (
    MODELS,
    OPTIONS,
    read_order,
)

MANY_STEPS = ", ".join(["1"] * (STEPS + 1))
BAD: list[tuple[str, str, str]] = [
    ("compensate", '{"target_deg": true}', "target_deg"),
    ("compensate", '{"target_deg": "45"}', "'45'"),
    ("compensate", '{"target_deg": 3600.001}', "is above 3600"),
    ("compensate", '{"target_deg": 1e999}', "finite"),
    ("compensate", '{"target_deg": NaN}', "finite"),
    ("compensate", '{"target_deg": 1, "speed_deg_s": 1e-300}', "0.1"),
    ("compensate", '{"target_deg": 1, "speed_deg_s": 360.1}', "360"),
    ("compensate", '{"target_deg": 1, "settle_s": 600.1}', "600"),
    ("compensate", '{"target_deg": 1, "strategy": "a\\u0000b"}', "strategy"),
    ("compensate", '{"target_deg": 1, "strategy": "../none"}', "strategy"),
    ("compensate", f'{{"target_deg": 1, "strategy": "{"a" * 65}"}}', "strategy"),
    ("compensate", '{"target_deg": 1, "strategy": "\\ud800"}', "json"),
    ("compensate", f'{{"target_deg": 1, "options": {{"steps_deg": [{"9" * 400}]}}}}', "'steps_deg'"),
    ("compensate", f'{{"target_deg": 1, "options": {{"steps_deg": [{MANY_STEPS}]}}}}', f"up to {STEPS} num"),
    ("compensate", '{"target_deg": 1, "options": {"steps_deg": [true]}}', "'steps_deg'"),
    ("compensate", '{"target_deg": 1, "options": {"steps_deg": [[1]]}}', "'steps_deg'"),
    ("compensate", '{"target_deg": 1, "options": {"speed_deg_s": [1, 0.09]}}', "0.1 to 360"),
    ("compensate", '{"target_deg": 1, "options": {"dwell_s": 601}}', "0.1 to 600"),
    ("compensate", '{"target_deg": 1, "options": {"a": {"b": 1}}}', "'a'"),
    ("compensate", '{"target_deg": 1, "options": {"__class__.x": 1}}', "__class__.x"),
    ("compensate", json.dumps({"target_deg": 1, "options": {f"o{n}": 1 for n in range(OPTIONS + 1)}}), "16"),
    ("compensate", '{"target_deg": 1, "out": "/tmp"}', "out"),
    ("compensate", '{"target_deg": 1, "options": ' + "[" * 50_000, "json"),
    ("compensate", "", "target_deg"),
    ("compensate", "[]", "the request"),
    ("jog", "{}", "either by_deg or to_deg"),
    ("jog", '{"by_deg": 1, "to_deg": 1}', "either by_deg or to_deg"),
    ("jog", '{"by_deg": 1, "speed_deg_s": 0.0999}', "0.1"),
    ("home", '{"by": "star"}', "by"),
    ("stop", '{"reason": "a\\u0000b"}', "reason"),
    ("stop", '{"reason": "a\\nb"}', "reason"),
    ("stop", f'{{"reason": "{"x" * 201}"}}', "200"),
    ("hold", '{"a": 1}', "a"),
    ("take_lease", "{}", "holder"),
]  # fmt: skip


@pytest.mark.parametrize(("name", "text", "told"), BAD, ids=range(len(BAD)))
def test_what_cannot_be_asked_is_one_sentence(name: str, text: str, told: str) -> None:
    with pytest.raises(BadInput) as caught:
        read_order(name, text.encode())
    sentence = str(caught.value)
    assert told in sentence.lower() or told in sentence
    assert sentence.isprintable()
    assert len(sentence) < 400


GOOD: list[tuple[str, dict[str, Any]]] = [
    ("compensate", {"target_deg": -MOST_DEG, "speed_deg_s": SLOWEST_DEG_S, "settle_s": 0.1}),
    ("compensate", {"target_deg": MOST_DEG, "speed_deg_s": FASTEST_DEG_S, "settle_s": 600.0}),
    ("compensate", {"target_deg": 1, "options": {"steps_deg": [1.5] * STEPS, "speed_deg_s": 0.1, "a": None}}),
    ("compensate", {"target_deg": 1, "options": {"use_hall": True, "rotations": 6, "ratio": 0.7}}),
    ("jog", {"by_deg": -5}), ("jog", {"to_deg": 0}), ("home", {}), ("home", {"by": "here", "angle_deg": 90}),
    ("stop", {"reason": "Mittag: ü"}), ("clear", {}), ("take_lease", {"holder": "anna"}),
]  # fmt: skip


@pytest.mark.parametrize(("name", "document"), GOOD, ids=range(len(GOOD)))
def test_what_may_be_asked_is_the_same_after_another_crossing(name: str, document: dict[str, Any]) -> None:
    order = read_order(name, json.dumps(document).encode())
    again = read_order(name, json.loads(json.dumps(order.model_dump())))
    assert again == order
    for key, value in document.items():
        assert getattr(order, key) == value


def test_whole_numbers_stay_whole() -> None:
    order = read_order("compensate", b'{"target_deg": 1, "options": {"rotations": 6}}')
    assert isinstance(order.model_dump()["options"]["rotations"], int)


def test_an_empty_body_stands_for_the_defaults() -> None:
    for name in ("stop", "home", "hold", "release", "clear"):
        assert read_order(name, b"") == MODELS[name]()
