"""Words beside points touch no mark, no other word and no edge."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from levels import examples

from neurotact.figures.labels import label_points
from neurotact.figures.style import new_figure

PLACES = st.lists(st.tuples(st.integers(0, 12), st.integers(0, 12)), min_size=1, max_size=9)
MARK_pt = 6.0


def labelled(places, **axes_settings):
    axes = new_figure(2.4, 3.0).subplots()
    x, y = np.array(places, float).T + 1.0
    axes.plot(x, y, "o-", ms=MARK_pt)
    axes.set(**axes_settings)
    words = [f"{index}00 ms" for index in range(len(x))]
    return axes, label_points(axes, x, y, words, fontsize=6.5), x, y


def boxes(axes):
    axes.figure.draw_without_rendering()
    return [text.get_window_extent() for text in axes.texts]


@examples(25)
@given(PLACES, st.sampled_from(["linear", "log"]))
def test_no_word_touches_another_a_mark_or_the_edge(places, scale):
    axes, n_written, x, y = labelled(places, xscale=scale)
    found = boxes(axes)
    frame = axes.get_window_extent()
    assert len(found) == n_written <= len(places)
    marks = axes.transData.transform(np.column_stack([x, y]))
    half = MARK_pt / 2 * axes.figure.dpi / 72
    for index, box in enumerate(found):
        # An annotation that is joined to its point by a line has an extent that holds the line too.
        if axes.texts[index].arrow_patch is not None:
            continue
        assert frame.x0 - 0.5 <= box.x0
        assert box.x1 <= frame.x1 + 0.5
        assert frame.y0 - 0.5 <= box.y0
        assert box.y1 <= frame.y1 + 0.5
        for left, bottom in marks - half:
            size = 2 * half
            assert box.x1 <= left or box.x0 >= left + size or box.y1 <= bottom or box.y0 >= bottom + size
        words = [other for at, other in enumerate(found) if at != index and axes.texts[at].arrow_patch is None]
        assert not any(box.overlaps(other) for other in words)


def test_points_far_apart_all_have_their_word():
    axes, n_written, _, _ = labelled([(0, 0), (6, 6), (12, 0), (0, 12), (12, 12)])
    assert n_written == 5
    assert [text.get_text() for text in axes.texts] == ["000 ms", "100 ms", "200 ms", "300 ms", "400 ms"]


def test_a_point_walled_in_by_marks_has_no_word():
    axes = new_figure(2.4, 3.0).subplots()
    grid = np.array([(x, y) for x in range(13) for y in range(13)], float)
    axes.plot(*grid.T, "s", ms=14.0)
    assert label_points(axes, [6.0], [6.0], ["walled in"]) == 0
    assert not axes.texts


def test_a_word_that_stands_apart_is_joined_to_its_point():
    axes = new_figure(2.4, 3.0).subplots()
    axes.plot([5.0], [5.0], "o", ms=13.0)
    axes.set(xlim=(0, 10), ylim=(0, 10))
    assert label_points(axes, [5.0], [5.0], ["a"]) == 1
    assert axes.texts[0].arrow_patch is not None


def test_of_free_places_the_one_that_crosses_no_line_is_taken():
    axes = new_figure(2.4, 3.0).subplots()
    axes.plot([5.0, 10.0], [5.0, 5.0], "-")
    axes.plot([5.0], [5.0], "o", ms=4)
    axes.set(xlim=(0, 10), ylim=(0, 10))
    label_points(axes, [5.0], [5.0], ["word"])
    (box,) = boxes(axes)
    (_, line) = axes.transData.transform((5.0, 5.0))
    assert not box.y0 <= line <= box.y1 or box.x1 < axes.transData.transform((5.0, 5.0))[0]
