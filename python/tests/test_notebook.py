"""What a notebook shows."""

import base64
from html.parser import HTMLParser
from pathlib import Path

import pytest

import wavex

HOSTILE = '<img src=x onerror=alert(1)>"&amp;\N{RIGHT-TO-LEFT OVERRIDE}'


class Checked(HTMLParser):
    """Reads tags and text; fails at what could run."""

    def __init__(self, html: str) -> None:
        super().__init__()
        self.tags: list[str] = []
        self.open: list[str] = []
        self.text = ""
        self.feed(html)
        self.close()
        assert not self.open

    def handle_starttag(self, tag, attributes):
        assert tag in {"table", "caption", "tr", "th", "td", "pre", "svg", "polyline", "img"}
        for name, value in attributes:
            assert name in {"width", "height", "fill", "stroke", "points", "alt", "src"}
            assert name != "src" or value.startswith("data:image/svg+xml;base64,")
        self.tags.append(tag)
        if tag != "img":
            self.open.append(tag)

    def handle_startendtag(self, tag, attributes):
        self.handle_starttag(tag, attributes)
        self.open.pop()

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        self.text += data + "\n"


@pytest.fixture(scope="module")
def hostile(flight, tmp_path_factory):
    """A recording whose name and instrument are HTML."""
    pa = pytest.importorskip("pyarrow")
    import pyarrow.ipc

    with pa.ipc.open_file(flight.path) as file:
        table = file.read_all()
    names = {b"wavex.instrument": HOSTILE.encode(), b"wavex.serial": b"<script>alert(2)</script>"}
    folder = tmp_path_factory.mktemp("<script>alert(3)<")
    path = folder / (HOSTILE.replace("/", "") + ".arrow")
    schema = table.schema.with_metadata({**table.schema.metadata, **names})
    with pa.ipc.new_file(path, schema) as file:
        for batch in table.cast(schema).to_batches():
            file.write_batch(batch)
    return wavex.open(path)


def test_a_recording_is_a_table_of_metadata(flight):
    recording = wavex.open(flight.path)
    shown = Checked(recording._repr_html_())
    assert "flight.arrow" in shown.text and "1 ns" in shown.text and str(Path(flight.path).parent) in shown.text
    # The recording is read for counts only when they are asked for.
    assert "`recording.info.shots` counts them" in shown.text
    assert recording.info.shots == 4000
    assert "20, 4000" in Checked(recording._repr_html_()).text


def test_a_model_is_a_table_of_channels(model):
    shown = Checked(model._repr_html_())
    assert shown.tags.count("polyline") == len(model.channels)
    assert "low" in shown.text and f"{model.noise_sd_dn('low'):.3f} DN" in shown.text


def test_an_explanation_is_a_picture_and_a_table(flight, model):
    explanation = wavex.explain(flight, 557, model)
    html = explanation._repr_html_()
    shown = Checked(html)
    assert shown.tags == ["img", "pre"] and explanation.text.splitlines()[0] in shown.text
    assert base64.b64decode(html.split("base64,")[1].split('"')[0]).decode() == explanation.svg


def test_hostile_names_are_text(hostile):
    shown = Checked(hostile._repr_html_())
    assert "<img src=x onerror=alert(1)>" in shown.text and "<script>alert(2)</script>" in shown.text
    assert "\N{RIGHT-TO-LEFT OVERRIDE}" not in shown.text
    explanation = wavex.explain(hostile, 5)
    Checked(explanation._repr_html_())
    assert "<img" not in explanation.svg and "<script" not in explanation.svg
    Checked(wavex.calibrate(hostile)._repr_html_())
