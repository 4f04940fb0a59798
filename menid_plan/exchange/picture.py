"""A drawing of a policy as a PNG image, by Matplotlib.

The layout is Sugiyama's (Sugiyama, Tagawa and Toda 1981): layers by the number of steps from the
initial state, left to right, or downwards where that comes closer to the shape of a page; within a
layer an order with few crossings, found by barycentres; then places that keep
the order and bring neighbours close. All lengths are in points, 1/72 inch.
"""

from __future__ import annotations

import io
import itertools
import math
from dataclasses import dataclass, field
from functools import cache
from typing import Any, TypeAlias

from menid_plan.exchange.drawing import Drawing, Node
from menid_plan.solving import MissingDependencyError

_FONT = 9.0
_LINE = 12.0
_PAD = 6.0
_APART = 16.0  # between two boxes of a layer
_GAP = 46.0  # between two layers, beside the labels of the edges
_SWEEPS = 24
_SHAPE = 1.6  # the width of a page by its height
_SMALL = 8.0
_TOP = 34.0

_FILL = {"": "white", "goal": "#e3f4e1"}
_FILL_INITIAL = "#e4eefb"
_FILL_END = "#e6e6e6"
_INK = "#333333"

_Point: TypeAlias = tuple[float, float]
_Rectangle: TypeAlias = tuple[float, float, float, float]


@dataclass(slots=True, eq=False)
class _Box:
    """A node with its size and place, or (without a node) a point where an edge passes a layer.

    The layout speaks of *along*, the direction from layer to layer, and *across* it. ``at`` is where
    the box begins along, ``middle`` its middle across; ``room`` is what a loop takes before it, across.
    """

    layer: int
    node: Node | None = None
    along: float = 0.0
    across: float = 10.0
    room: float = 0.0
    at: float = 0.0
    middle: float = 0.0
    near: list[_Box] = field(default_factory=list)


@dataclass(slots=True, eq=False)
class _Path:
    """An edge and the boxes that it passes, source and target included."""

    boxes: list[_Box]
    lines: tuple[str, ...]
    chance: float


def png_bytes(drawing: Drawing, dpi: int = 130) -> bytes:
    """The image as a PNG file; MissingDependencyError without Matplotlib."""
    try:
        from matplotlib.backends.backend_agg import FigureCanvasAgg
        from matplotlib.figure import Figure
    except ImportError as error:
        raise MissingDependencyError(
            "drawing an image needs Matplotlib: pip install 'menid-plan[draw]'; --dot needs nothing"
        ) from error
    pictures = [_Picture(drawing, down=down) for down in (False, True)]
    picture = min(pictures, key=lambda p: abs(math.log(p.size[0] / p.size[1] / _SHAPE)))
    width, height = picture.size
    figure = Figure(figsize=(width / 72, height / 72), facecolor="white")
    canvas = FigureCanvasAgg(figure)
    axes = figure.add_axes((0, 0, 1, 1))
    axes.set_xlim(0, width)
    axes.set_ylim(height, 0)
    axes.axis("off")
    picture.draw(axes)
    stream = io.BytesIO()
    canvas.print_figure(stream, dpi=dpi, format="png")
    return stream.getvalue()


@cache
def _text_width(text: str, *, bold: bool = False, size: float = _FONT) -> float:
    from matplotlib.font_manager import FontProperties
    from matplotlib.textpath import TextPath

    weight = "bold" if bold else "normal"
    path = TextPath((0, 0), text, size=size, prop=FontProperties(weight=weight))
    return float(path.get_extents().width) if text.strip() else 0.0


def _node_lines(node: Node) -> list[tuple[str, bool]]:
    """The lines of a node's box, and whether each is bold."""
    lines = [(line, False) for line in node.state]
    if node.action:
        lines.append((node.action, True))
    if node.left:
        lines.append((node.left, False))
    if node.end:
        lines.append((node.end, True))
    return lines


class _Picture:
    """The layout of a drawing, and how it is drawn."""

    def __init__(self, drawing: Drawing, *, down: bool) -> None:
        self.drawing = drawing
        self.down = down
        self.boxes = self._sized()
        self.paths: list[_Path] = []
        self.loops: list[tuple[_Box, tuple[str, ...], float]] = []
        self.layers: list[list[_Box]] = [[] for _ in range(max(b.layer for b in self.boxes) + 1)]
        for box in self.boxes:
            self.layers[box.layer].append(box)
        self._route()
        self._order()
        self._place()
        self.labels: list[_Rectangle] = []

    def _sized(self) -> list[_Box]:
        """A box for every node, in the layer of its distance from the first; the horizon comes last."""
        nodes, edges = self.drawing.nodes, self.drawing.edges
        depth = {0: 0}
        queue = [0]
        for number in queue:
            for edge in edges:
                if edge.source == number and edge.target not in depth:
                    depth[edge.target] = depth[number] + 1
                    queue.append(edge.target)
        for edge in edges:
            if nodes[edge.target].end == "horizon":  # from everywhere, with long labels
                depth[edge.target] = max(depth[edge.target], 1 + depth.get(edge.source, 0))
        boxes = []
        for number, node in enumerate(nodes):
            lines = _node_lines(node)
            width = max((_text_width(line, bold=bold) for line, bold in lines), default=0.0)
            size = (width + 2 * _PAD + 4, len(lines) * _LINE + 2 * _PAD)
            along, across = size[::-1] if self.down else size
            boxes.append(_Box(depth.get(number, 0), node, along, across))
        return boxes

    def _label_size(self, lines: tuple[str, ...]) -> tuple[float, float]:
        """The size of an edge's label along and across."""
        wide = max((_text_width(line, size=_SMALL) for line in lines), default=0.0)
        return (9.5 * len(lines), wide) if self.down else (wide, 9.5 * len(lines))

    def _route(self) -> None:
        """Lead edges that go back over several layers through points of their own."""
        for edge in self.drawing.edges:
            source, target = self.boxes[edge.source], self.boxes[edge.target]
            if source is target:
                self.loops.append((source, edge.lines, edge.probability))
                source.room = 20.0 + self._label_size(edge.lines)[1]
                continue
            way = [source]
            step = 1 if target.layer > source.layer else -1
            for layer in range(source.layer + step, target.layer, step):
                point = _Box(layer)
                self.layers[layer].append(point)
                way.append(point)
            way.append(target)
            for one, other in itertools.pairwise(way):
                one.near.append(other)
                other.near.append(one)
            self.paths.append(_Path(way, edge.lines, edge.probability))

    def _order(self) -> None:
        """Sort each layer by the mean places of its neighbours, again and again; keep the best."""
        best, best_crossings = [list(layer) for layer in self.layers], self._crossings()
        for sweep in range(_SWEEPS):
            down = sweep % 2 == 0
            numbers = range(1, len(self.layers)) if down else range(len(self.layers) - 2, -1, -1)
            for number in numbers:
                beside = self.layers[number - 1 if down else number + 1]
                place = {id(box): index for index, box in enumerate(beside)}
                layer = self.layers[number]
                now = {id(box): float(index) for index, box in enumerate(layer)}
                for box in layer:
                    seen = [place[id(other)] for other in box.near if id(other) in place]
                    if seen:
                        now[id(box)] = sum(seen) / len(seen)
                layer.sort(key=lambda box, now=now: now[id(box)])  # type: ignore[misc]
            crossings = self._crossings()
            if crossings < best_crossings:
                best, best_crossings = [list(layer) for layer in self.layers], crossings
        self.layers = best

    def _crossings(self) -> int:
        """How many pairs of neighbouring layers' edges cross."""
        total = 0
        for number in range(len(self.layers) - 1):
            place = {id(box): index for index, box in enumerate(self.layers[number + 1])}
            ends = [
                (index, place[id(other)])
                for index, box in enumerate(self.layers[number])
                for other in box.near
                if id(other) in place
            ]
            total += sum(a[0] < b[0] and a[1] > b[1] for a in ends for b in ends)
        return total

    def _place(self) -> None:
        """Give every box its place."""
        for layer in self.layers:
            end = 0.0
            for box in layer:
                box.middle = end + box.room + box.across / 2
                end = box.middle + box.across / 2 + _APART
        for sweep in range(60):
            for layer in self.layers if sweep % 2 == 0 else self.layers[::-1]:
                _settle(layer)
        every = [box for layer in self.layers for box in layer]
        least = min(box.middle - box.across / 2 - box.room for box in every)
        start = 18.0 if self.down else _TOP
        at = _TOP + 26.0 if self.down else 30.0
        for number, layer in enumerate(self.layers):
            longest = max(box.along for box in layer)
            for box in layer:
                box.at = at + (longest - box.along) / 2
                box.middle += start - least
            at += longest + self._gap(number)
        size = (
            max(box.at + box.along for box in every) + (20.0 if self.down else 46.0),
            max(box.middle + box.across / 2 for box in every) + 20.0,
        )
        width, height = self._point(*size)
        title = _text_width(self.drawing.title, bold=True, size=11) + 24
        self.size = (max(width, title), height)

    def _gap(self, number: int) -> float:
        """The room between a layer and the next."""
        beside = {id(box) for layer in self.layers[number : number + 2] for box in layer}
        here = {id(box) for box in self.layers[number]}
        size = 0.0
        for path in self.paths:
            ends = {id(path.boxes[0]), id(path.boxes[1])}
            if ends <= beside and ends & here:
                size = max(size, self._label_size(path.lines)[0])
        return size + (42.0 if self.down else _GAP)

    def _point(self, along: float, across: float) -> _Point:
        """A point of the layout on the page."""
        return (across, along) if self.down else (along, across)

    def _rectangle(self, box: _Box) -> _Rectangle:
        """The box on the page: left, top, right, bottom."""
        first = self._point(box.at, box.middle - box.across / 2)
        last = self._point(box.at + box.along, box.middle + box.across / 2)
        return (*first, *last)

    # --------------------------------------------------------------------------------- drawing

    def draw(self, axes: Any) -> None:
        """Draw edges, then boxes over them, then the edges' labels."""
        axes.text(12, 16, self.drawing.title, size=11, weight="bold", color=_INK, va="center")
        ports = self._ports()
        curves = [self._curve(number, ports) for number in range(len(self.paths))]
        for path, curve in zip(self.paths, curves, strict=True):
            self._arrow(axes, curve, path.chance)
        for box, _, chance in self.loops:
            at, side, r = box.at + box.along / 2, box.middle - box.across / 2, 11.0
            loop = [(at - r, side), (at - r, side - 2 * r), (at + r, side - 2 * r), (at + r, side)]
            self._arrow(axes, [self._point(*point) for point in loop], chance)
        for box in self.boxes:
            self._box(axes, box)
        for box, lines, _ in self.loops:
            side = box.middle - box.across / 2 - 18 - self._label_size(lines)[1] / 2
            self._label(axes, [self._point(box.at + box.along / 2, side)], lines)
        for path, curve in zip(self.paths, curves, strict=True):
            places = [_at(curve, t) for t in (0.5, 0.42, 0.58, 0.34, 0.66, 0.26, 0.74, 0.18, 0.82)]
            self._label(axes, places, path.lines)

    def _ports(self) -> dict[tuple[int, int], _Point]:
        """Where each path leaves its first box and enters its last: by path and end (0 or 1)."""
        sides: dict[tuple[int, bool], list[tuple[float, int, int]]] = {}
        for number, path in enumerate(self.paths):
            for end, (box, other) in enumerate(
                ((path.boxes[0], path.boxes[1]), (path.boxes[-1], path.boxes[-2]))
            ):
                before = other.layer < box.layer
                sides.setdefault((id(box), before), []).append((other.middle, number, end))
        found = {}
        by_id = {id(box): box for box in self.boxes}
        for (identity, before), ends in sides.items():
            box = by_id[identity]
            for index, (_, number, end) in enumerate(sorted(ends)):
                part = (index + 1) / (len(ends) + 1) - 0.5
                at = box.at if before else box.at + box.along
                found[number, end] = (at, box.middle + part * box.across * 0.8)
        return found

    def _curve(self, number: int, ports: dict[tuple[int, int], _Point]) -> list[_Point]:
        """The control points of a path's cubic Bezier curves, one after the other, on the page."""
        path = self.paths[number]
        first, last = ports[number, 0], ports[number, 1]
        if path.boxes[0].layer == path.boxes[-1].layer:
            out = 26.0 + 0.08 * abs(first[1] - last[1])
            curve = [first, (first[0] + out, first[1]), (last[0] + out, last[1]), last]
            return [self._point(*point) for point in curve]
        points = [first, *((p.at, p.middle) for p in path.boxes[1:-1]), last]
        curve = [first]
        for one, other in itertools.pairwise(points):
            bend = 0.45 * (other[0] - one[0])
            curve += [(one[0] + bend, one[1]), (other[0] - bend, other[1]), other]
        return [self._point(*point) for point in curve]

    @staticmethod
    def _arrow(axes: Any, curve: list[_Point], chance: float) -> None:
        from matplotlib.patches import FancyArrowPatch
        from matplotlib.path import Path

        codes = [Path.MOVETO] + [Path.CURVE4] * (len(curve) - 1)
        axes.add_patch(
            FancyArrowPatch(
                path=Path(curve, codes), arrowstyle="-|>", mutation_scale=9, color="#5b6b7b",
                linewidth=0.6 + 1.2 * chance, shrinkA=0, shrinkB=0, zorder=1,
            )
        )  # fmt: skip

    def _box(self, axes: Any, box: _Box) -> None:
        from matplotlib.patches import FancyArrowPatch, FancyBboxPatch

        node = box.node
        assert node is not None
        fill = _FILL_INITIAL if node.initial else _FILL.get(node.end, _FILL_END)
        left, top, right, bottom = self._rectangle(box)
        outlines = (0.0, 2.5) if node.end == "goal" else (0.0,)
        for inset in outlines:
            axes.add_patch(
                FancyBboxPatch(
                    (left + inset, top + inset), right - left - 2 * inset, bottom - top - 2 * inset,
                    boxstyle="round,pad=0,rounding_size=5", facecolor=fill, edgecolor=_INK,
                    linewidth=1.6 if node.initial else 0.9, zorder=2,
                    linestyle="--" if node.end and node.end != "goal" else "-",
                )
            )  # fmt: skip
        if node.initial:
            start = [self._point(at, box.middle) for at in (box.at - 22, box.at)]
            axes.add_patch(
                FancyArrowPatch(
                    *start, arrowstyle="-|>", mutation_scale=11, color=_INK, linewidth=1.6,
                    shrinkA=0, shrinkB=0, zorder=1,
                )
            )  # fmt: skip
        for index, (line, bold) in enumerate(_node_lines(node)):
            axes.text(
                (left + right) / 2, top + _PAD + (index + 0.5) * _LINE, line, size=_FONT,
                weight="bold" if bold else "normal", color="#0b4f9e" if bold else _INK,
                ha="center", va="center_baseline", zorder=3,
            )  # fmt: skip

    def _label(self, axes: Any, places: list[_Point], lines: tuple[str, ...]) -> None:
        """Write an edge's label where it hides the least."""
        if not lines:
            return
        width = max(_text_width(line, size=_SMALL) for line in lines) + 4
        height = 9.5 * len(lines) + 2
        taken = self.labels + [self._rectangle(box) for box in self.boxes]

        def hidden(place: _Point) -> float:
            x, y = place
            own = (x - width / 2, y - height / 2, x + width / 2, y + height / 2)
            return sum(_overlap(own, other) for other in taken)

        x, y = min(places, key=hidden)
        self.labels.append((x - width / 2, y - height / 2, x + width / 2, y + height / 2))
        axes.text(
            x, y, "\n".join(lines), size=_SMALL, color="#7a3b00", ha="center", va="center", zorder=4,
            linespacing=1.05,
            bbox={"boxstyle": "square,pad=0.1", "facecolor": "white", "edgecolor": "none",
                  "alpha": 0.85},
        )  # fmt: skip


def _settle(layer: list[_Box]) -> None:
    """Move the boxes of a layer to the mean places of their neighbours, in order and apart.

    The least squares under these constraints, by pooling adjacent violators.
    """
    offsets, total = [], 0.0
    for index, box in enumerate(layer):
        if index:
            total += layer[index - 1].across / 2 + _APART + box.room + box.across / 2
        offsets.append(total)
    pools: list[tuple[float, int]] = []  # mean, number of boxes
    for box, offset in zip(layer, offsets, strict=True):
        wanted = sum(b.middle for b in box.near) / len(box.near) if box.near else box.middle
        mean, size = wanted - offset, 1
        while pools and pools[-1][0] > mean:
            other, count = pools.pop()
            mean, size = (other * count + mean * size) / (count + size), count + size
        pools.append((mean, size))
    places = [mean for mean, size in pools for _ in range(size)]
    for box, offset, place in zip(layer, offsets, places, strict=True):
        box.middle = place + offset


def _at(curve: list[_Point], t: float) -> _Point:
    """A point of a curve of cubic pieces, t from 0 to 1."""
    pieces = (len(curve) - 1) // 3
    piece = min(int(t * pieces), pieces - 1)
    u = t * pieces - piece
    weights = ((1 - u) ** 3, 3 * u * (1 - u) ** 2, 3 * u * u * (1 - u), u**3)
    points = curve[3 * piece : 3 * piece + 4]
    return (
        sum(w * p[0] for w, p in zip(weights, points, strict=True)),
        sum(w * p[1] for w, p in zip(weights, points, strict=True)),
    )


def _overlap(one: _Rectangle, other: _Rectangle) -> float:
    """The area that two rectangles share."""
    width = min(one[2], other[2]) - max(one[0], other[0])
    height = min(one[3], other[3]) - max(one[1], other[1])
    return max(0.0, width) * max(0.0, height)
