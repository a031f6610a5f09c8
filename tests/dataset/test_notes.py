"""What is said of many files is said once."""

from needle_rig.dataset.notes import gathered


def test_notes_that_differ_in_file_and_numbers_are_one() -> None:
    notes = [
        f"data/trials/0{k}.csv:{k}: hall_4 is missing in {100 * k} samples; not compared" for k in (1, 3, 2)
    ]
    assert gathered(notes) == (
        "data/trials/01.csv and 2 others: hall_4 is missing in 100 to 300 samples; not compared",
    )


def test_a_sensor_is_no_number_and_two_files_are_few() -> None:
    notes = [
        "a.csv: hall_1 is missing in every sample",
        "b.csv: hall_2 is missing in every sample",
        "c.csv: hall_3 is missing in every sample",
        "a.csv:4: base_torque is stuck for 1.5 s",
        "b.csv:9: base_torque is stuck for 2.5 s",
        "the rig has no name",
    ]
    assert gathered(notes) == tuple(notes)


def test_files_count_and_not_notes() -> None:
    notes = [f"a.csv:{k}: hall_1 wraps by a whole turn; unwrapped" for k in range(5)]
    assert gathered(notes) == tuple(notes)
    assert gathered(("x: 1,250 rows", "y: 18,620 rows", "z: 900 rows")) == (
        "x and 2 others: 900 to 18,620 rows",
    )
    assert gathered([]) == ()
