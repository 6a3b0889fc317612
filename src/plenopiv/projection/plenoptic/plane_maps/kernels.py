"""CPU kernels that spread voxels into the maps of their planes (``maps``) and read views off them, and back.

A map is worked on strip by strip, each some rows that stay in the second-level cache. Threads own planes; forward, a
fixed number of images is summed in order, so that no sum depends on the number of threads.

Kernels are kept small on purpose: inlined into one large function the innermost loops take twice as long.
"""

from __future__ import annotations

import numpy as np

from plenopiv.kernels import borrowed, inlined, kernel, part
from plenopiv.projection.plenoptic.pixel_weights import plane_of
from plenopiv.projection.plenoptic.plane_maps.interpolation import read_places, write_places
from plenopiv.projection.plenoptic.plane_maps.simd import LANES
from plenopiv.projection.plenoptic.plane_maps.voxel_rows import first_line, spread_rows, sum_rows
from plenopiv.threads import in_turn

F = np.float32
ZERO = np.int64(0)  # of a plain 0 Numba makes a type of its own, and compiles twice what takes it
BLOCK = 1024  # pixels placed at once
STRIP = 1 << 17  # points worked on at once: they stay in the second-level cache
RUNS = 16  # of planes, shared out among threads; forward, as many partial images are summed in order
FIRST = in_turn(RUNS)  # group of planes of a run, which takes every RUNS-th
ROUNDING = F(0.01)  # rows that a place may be off by it
OFF = F(1.15)  # px that a pixel's q may be off its view's: its phase, its lit part's middle, drift


@part
def pixels_near(cam, plane, size, border, views, n, low, high):
    """Of the pixels of view n, which are sorted by row, four bounds: between the outer ones lie all whose footprints
    may be centred on rows low <= y < high of a map, between the inner ones none whose are not. A pixel's q along y is
    less than OFF away from the view's ``middle``."""
    points, t = size[2], views.pixels[1]
    shift = F(border[1]) - points * cam.y0 + points * plane.step_y * views.middle[n]
    slack = OFF * points * abs(plane.step_y) + ROUNDING
    found = (0, 0, 0, 0)
    for bound in range(4):
        row = (F(low) if bound < 2 else F(high)) + (slack if bound % 2 else -slack) - shift
        a, b = max(views.start[n], found[3]), views.start[n + 1]
        while a < b:
            c = (a + b) // 2
            if points * plane.voxel_t * t[c] < row:
                a = c + 1
            else:
                b = c
        found = found[1], found[2], found[3], a
    return found


@inlined
def steps_of(cam, plane, size, border):
    """Where lens (0, 0) would have its footprint centred on a map, and the way for a step in s, q, t and q again."""
    points = size[2]
    x0, y0 = F(border[0]) - points * cam.x0, F(border[1]) - points * cam.y0
    return x0, y0, points * plane.voxel_s, points * plane.step_x, points * plane.voxel_t, points * plane.step_y


@part
def places(cam, plane, size, border, views, begin, count, top, at, across, along):
    """Where the footprints of wholly lit pixels ``begin`` onwards are centred on a strip, of a map of ``size`` (rows,
    columns, points to a voxel), whose first row is ``top``: the point above and to the left, the way to the next column
    and row. Those off the map along x go to its border, where it is dark."""
    x0, y0, xs, xq, ys, yq = steps_of(cam, plane, size, border)
    width, top, right, p = np.int32(size[1]), np.int32(top), F(size[1]) - F(1.01), views.pixels
    s, t, qx, qy = p[0, begin:], p[1, begin:], p[2, begin:], p[3, begin:]
    for c in range(count):
        x, y = min(max(x0 + xs * s[c] + xq * qx[c], F(0)), right), max(y0 + ys * t[c] + yq * qy[c], F(0))
        i, j = np.int32(x), np.int32(y)
        across[c], along[c] = x - F(i), y - F(j)
        at[c] = (j - top) * width + i


@part
def places_at_rim(cam, plane, size, border, views, begin, count, top, at, across, along, lit):
    """The same for pixels that the aperture's rim cuts, and their lit shares."""
    x0, y0, xs, xq, ys, yq = steps_of(cam, plane, size, border)
    width, top, right, p = np.int32(size[1]), np.int32(top), F(size[1]) - F(1.01), views.pixels
    s, t, qx, qy, off = p[0, begin:], p[1, begin:], p[2, begin:], p[3, begin:], plane.spread - views.first
    share, qx_off, qy_off, share_off = p[4, begin:], p[5, begin:], p[6, begin:], p[7, begin:]
    for c in range(count):
        x = min(max(x0 + xs * s[c] + xq * (qx[c] + off * qx_off[c]), F(0)), right)
        y = max(y0 + ys * t[c] + yq * (qy[c] + off * qy_off[c]), F(0))
        i, j = np.int32(x), np.int32(y)
        across[c], along[c] = x - F(i), y - F(j)
        at[c] = (j - top) * width + i
        lit[c] = share[c] + off * share_off[c]


@part
def only_within(first, last, count, at, lit):
    """Pixels that are not at points first <= at < last take no part."""
    first, last = np.int32(first), np.int32(last)
    for c in range(count):
        here = (at[c] >= first) & (at[c] < last)
        at[c] = at[c] if here else 0
        lit[c] = lit[c] if here else F(0)


@inlined
def place(cam, plane, size, border, views, n, begin, count, top, low, high, inside, at, across, along, lit):
    """``places`` of pixels of view n and their lit shares, which are 0 off the rows low <= y < high; of those that are
    wholly lit and ``inside`` for certain, ``lit`` stays as it is. Inlined, as a call would pass a hundred arguments."""
    if views.rim[n]:
        places_at_rim(cam, plane, size, border, views, begin, count, top, at, across, along, lit)
    else:
        places(cam, plane, size, border, views, begin, count, top, at, across, along)
        if not inside:
            lit[:] = F(1)
    if not inside:
        only_within((low - top) * size[1], (high - top) * size[1], count, at, lit)


@inlined
def runs_of(rim, bounds):
    """Runs of pixels (begin, end, whether they need no test): all but those near the strip's ends, and none where the
    rim cuts pixels."""
    inside = bounds[2] if not rim else bounds[1]
    return (bounds[0], bounds[1], False), (inside, bounds[3], False), (bounds[1], inside, True)


@part
def read(cam, plane, size, border, views, n, top, low, high, strip, light):
    """Add to ``light`` (count,) what the pixels of view n on rows low <= y < high of a map collect, whose rows from
    ``top`` on are ``strip`` (flat)."""
    at = np.empty(BLOCK, np.int32)
    across, along, lit = np.empty(BLOCK, np.float32), np.empty(BLOCK, np.float32), np.empty(BLOCK, np.float32)
    width, bounds = size[1], pixels_near(cam, plane, size, border, views, n, low, high)
    for first, last, inside in runs_of(views.rim[n], bounds):
        lit[:] = F(1)
        for begin in range(first, last, BLOCK):
            count = min(BLOCK, last - begin)
            place(cam, plane, size, border, views, n, begin, count, top, low, high, inside, at, across, along, lit)
            whole = count - count % LANES
            for c in range(0, whole, LANES):
                read_places(strip, width, at, across, along, lit, c, plane.light, light, begin + c)
            for c in range(whole, count):
                p = np.int64(at[c])
                above = strip[p] + across[c] * (strip[p + 1] - strip[p])
                p += width
                below = strip[p] + across[c] * (strip[p + 1] - strip[p])
                light[begin + c] += plane.light * lit[c] * (above + along[c] * (below - above))


@part
def write(cam, plane, size, border, views, n, top, low, high, image, strip):
    """The transpose of ``read`` but for ``plane.light``: add ``image`` (count,) to the strip."""
    at = np.empty(BLOCK, np.int32)
    across, along, lit = np.empty(BLOCK, np.float32), np.empty(BLOCK, np.float32), np.empty(BLOCK, np.float32)
    width, bounds = size[1], pixels_near(cam, plane, size, border, views, n, low, high)
    for first, last, inside in runs_of(views.rim[n], bounds):
        lit[:] = F(1)
        for begin in range(first, last, BLOCK):
            count = min(BLOCK, last - begin)
            place(cam, plane, size, border, views, n, begin, count, top, low, high, inside, at, across, along, lit)
            whole = count - count % LANES
            for c in range(0, whole, LANES):
                write_places(image, begin + c, at, across, along, lit, c, strip, width)
            for c in range(whole, count):
                p, part = np.int64(at[c]), lit[c] * image[begin + c]
                below = along[c] * part
                above = part - below
                above_right, below_right = across[c] * above, across[c] * below
                strip[p] += above - above_right
                strip[p + 1] += above_right
                p += width
                strip[p] += below - below_right
                strip[p + 1] += below_right


@part
def copy(source, count, out):
    """Copy a line: of one array into itself the compiler does so number by number, unless both are told apart."""
    for i in range(count):
        out[i] = source[i]


@part
def roll(strip, width, kept, lines):
    """Move the rows of a strip from ``kept`` on to its beginning; the others are dark."""
    if kept > 0:
        for line in range(lines - kept):
            copy(strip[(kept + line) * width :], width, strip[line * width :])
    strip[(lines - kept) * width : lines * width] = F(0)


@inlined
def rows_before(shape, line, ny):
    """The number of rows of voxels that reach only rows of a map before ``line``."""
    return min((((line - 1 - shape[2]) << shape[5]) - 1) // shape[4] + 1, ny)


@inlined
def shape_of(shapes, k):
    """What ``Maps.shape`` says of plane k, as numbers: an array is dear to take apart."""
    return shapes[k, 0], shapes[k, 1], shapes[k, 2], shapes[k, 3], shapes[k, 4], shapes[k, 5]


@inlined
def size_of(shape):
    """Rows and columns of a map, and points to a voxel."""
    return shape[0], shape[1], F(shape[4]) / F(1 << shape[5])


@inlined
def forward_planes(cam, plane, shape, border, planes, maps, ny, views, row_start, column, values, strip, spare, light):
    """Add to ``light`` (count,) what the pixels of some views collect of the listed voxels of ``planes`` (first, end),
    which share one map.

    The map is made strip by strip from above: rows of voxels are spread while they fit in, pixels read from the rows
    that no other voxel reaches, and what is left rolled to the strip's beginning."""
    size = size_of(shape)
    height, width, _ = size
    lines = strip.size // width
    strip[: lines * width] = F(0)
    top = j = ZERO
    while True:
        bottom = min(top + lines, height)
        stop = rows_before(shape, bottom, ny)
        for k in range(planes[0], planes[1]):
            rows = row_start[k * ny : (k + 1) * ny + 1]
            spread_rows(of_plane(maps, k), shape, j, stop, top, rows, column, values, strip, spare)
        j = stop
        finished = first_line(shape, j) if j < ny else bottom
        for n in range(views.start.size - 1):
            read(cam, plane, size, border, views, n, top, top, finished - 1, strip, light)
        if bottom == height:
            return
        roll(strip, width, finished - 1 - top, lines)
        top = finished - 1


@inlined
def gather_planes(
    cam, plane, shape, border, planes, maps, ny, views, row_start, column, image, multiply, strip, spare, out
):  # fmt: skip
    """What ``gather`` does for ``planes`` that share one map: it is made strip by strip from above, and rows of voxels
    are summed once all pixels around them are in."""
    size = size_of(shape)
    height, width, _ = size
    lines = strip.size // width
    strip[: lines * width] = F(0)
    top = written = j = ZERO
    while True:
        bottom = min(top + lines, height)
        for n in range(views.start.size - 1):
            write(cam, plane, size, border, views, n, top, written, bottom - 1, image, strip)
        written = bottom - 1
        stop = rows_before(shape, written, ny)
        for k in range(planes[0], planes[1]):
            rows = row_start[k * ny : (k + 1) * ny + 1]
            sum_rows(of_plane(maps, k), shape, j, stop, top, rows, column, strip, spare, multiply, out)
        j = stop
        if j == ny:
            return
        roll(strip, width, first_line(shape, j) - top, lines)
        top = first_line(shape, j)


def workspace_of(shape, size):
    """Points of a strip of any plane's map: ``size``, or what two rows of voxels reach if that is more; and number and
    length of the lines of a row, as ``rows`` needs them."""
    most = 0
    for height, width, rows, _, points, _ in shape.tolist():
        most = max(most, max(min(size // width, height), 2 * rows + points + 2) * width)
    return most, 1 + (1 << int(shape[:, 5].max())), int(shape[:, 1].max())


@inlined
def of_plane(maps, k):
    """A plane's shares, their outer products and the number of these."""
    return maps.shares[maps.start[k, 0] :], maps.parts[maps.start[k, 1] :], maps.rank[k]


@kernel
def forward(begin, end, cam, table, first, maps, workspace, views, ny, row_start, column, values, partial):
    """Light of the listed voxels in the pixels of views. Planes ``first[g]`` to ``first[g + 1]`` share one map, seen
    as ``table[g]`` is (``maps.Read``). Each row of ``partial`` (RUNS, count) takes that of some of them; rows ``begin``
    to ``end`` are filled. ``workspace``: as ``workspace_of`` tells it."""
    count, maps, views = first.size - 1, borrowed(maps), borrowed(views)
    row_start, column, values, partial = borrowed((row_start, column, values, partial))
    for c in range(begin, end):
        partial[c] = F(0)
        strip, spare = np.empty(workspace[0], np.float32), np.empty((workspace[1], workspace[2]), np.float32)
        for g in range(FIRST[c], count, RUNS):  # far from focus and near it alike
            planes = first[g], first[g + 1]
            if row_start[planes[0] * ny] < row_start[planes[1] * ny]:
                plane, size, edge = plane_of(table, g), shape_of(maps.shape, planes[0]), maps.border[planes[0]]
                forward_planes(
                    cam, plane, size, edge, planes, maps, ny, views, row_start, column, values, strip, spare, partial[c]
                )


@kernel
def gather(
    begin, end, cam, table, first, maps, workspace, views, ny, row_start, column, image, multiply, out
):  # fmt: skip
    """For each listed voxel the sum of ``image`` (count,) over the pixels of views, each by the share of a wholly lit
    pixel that the voxel gives it, into ``out``; with ``multiply``, their number, ``out`` times ``factor_of`` it.
    ``table``, ``first``: as for ``forward``."""
    count, maps, views = first.size - 1, borrowed(maps), borrowed(views)
    row_start, column, image, out = borrowed((row_start, column, image, out))
    for c in range(begin, end):
        strip, spare = np.empty(workspace[0], np.float32), np.empty((workspace[1], workspace[2]), np.float32)
        for g in range(FIRST[c], count, RUNS):
            planes = first[g], first[g + 1]
            if row_start[planes[0] * ny] < row_start[planes[1] * ny]:
                plane, size, edge = plane_of(table, g), shape_of(maps.shape, planes[0]), maps.border[planes[0]]
                gather_planes(
                    cam, plane, size, edge, planes, maps, ny, views, row_start, column, image, multiply, strip, spare,
                    out,
                )  # fmt: skip
