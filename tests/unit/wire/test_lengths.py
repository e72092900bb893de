from telenano.wire.lengths import in_nm


def test_a_length_is_stated_to_a_picometre() -> None:
    texts = [in_nm(length_m) for length_m in (1.393e-14, -1e-20, -1e-7, 1.2345678e-5, 1.05e-12, 4.9e-13)]
    assert texts == ["0 nm", "0 nm", "-100 nm", "12350 nm", "0.001 nm", "0 nm"]
