"""The equations of the paper give what was computed for them independently."""

from studies.reproduce import equations, reproduce


def test_every_equation_is_within_the_digits_of_its_expected_value():
    rows = equations()
    assert len(rows) >= 18
    for row in rows:
        # the expected values have three digits at least: half of the last one of 19.6
        assert abs(row.difference) < 3e-3, row


def test_a_page_has_the_curve_and_its_numbers(tmp_path):
    seen = []
    summary = reproduce(("equations", "fig6"), tmp_path, 8, lambda *args: seen.append(args))
    page = (tmp_path / "reproduce.html").read_text()
    assert "data:image/png;base64" in page
    assert "hand-over distance h*" in page
    assert summary["fig6"]["stiffness_n_per_m"] == 8.0
    assert seen[-1] == ("fig6", 2000, 2000)
