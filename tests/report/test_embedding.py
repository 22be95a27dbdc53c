"""What a page carries comes out again, or is said to be damaged."""

import base64
import gzip

from pivometer.report import embedding


def test_texts_come_back():
    text = "{“a”: 0.1}\n" * 1000
    assert embedding.unpacked(embedding.packed(text)) == text


def test_the_same_text_is_packed_to_the_same_bytes():
    assert embedding.packed("a" * 99) == embedding.packed("a" * 99)


def test_damage_of_every_kind_is_told():
    whole = embedding.packed("text " * 100)
    assert embedding.unpacked("not base64!") is None
    assert embedding.unpacked(whole[: len(whole) // 8 * 4]) is None
    assert embedding.unpacked(base64.b64encode(b"no gzip").decode()) is None
    assert embedding.unpacked(base64.b64encode(gzip.compress(b"\xff\xfe")).decode()) is None
    assert embedding.unpacked("") is None


def test_a_block_that_swells_beyond_any_result_is_not_unpacked(monkeypatch):
    monkeypatch.setattr(embedding, "LARGEST_BYTES", 1000)
    assert embedding.unpacked(embedding.packed("a" * 999)) == "a" * 999
    assert embedding.unpacked(embedding.packed("a" * 5000)) is None
