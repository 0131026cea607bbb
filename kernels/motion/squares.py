"""A frame's labels by squares of 2x2 pixels, and places of some squares of each label."""

from .._jit.kernel import kernel


@kernel(arrays=False)
def label_squares(labels, squares, sizes):
    """Label squares as the first of their pixels that has a label: others may be missing.

    Parameters
    ----------
    labels : (H, W) int32
    squares : (ceil(H / 2), ceil(W / 2)) intp
        Written.
    sizes : (N + 1,) intp
        Written: how many squares have each label.
    """
    height, width = labels.shape
    sizes[:] = 0
    for i in range(squares.shape[0]):
        top, bottom = labels[2 * i], labels[min(2 * i + 1, height - 1)]
        for j in range(squares.shape[1]):
            left, right = 2 * j, min(2 * j + 1, width - 1)
            label = top[left]
            if label == 0:
                label = top[right]
            if label == 0:
                label = bottom[left]
            if label == 0:
                label = bottom[right]
            squares[i, j] = label
            sizes[label] += 1


@kernel(arrays=False)
def find_places(squares, chosen, following, passed, places):
    """Find where some squares of each label are.

    Parameters
    ----------
    squares : (R * C,) intp
        Labels.
    chosen : (P,) intp
        Numbers of squares, counted from 0 label by label and row by row; label 0 has none. They do not fall.
    following : (N + 1,) intp
        Of each label, the first of `chosen` that is its own or a later one's; becomes that after its last.
    passed : (N + 1,) intp
        Squares of smaller labels, label 0 aside; becomes those of smaller ones and itself.
    places : (P,) intp
        Written: index of each chosen square.
    """
    for k in range(len(squares)):
        label = squares[k]
        if label > 0:
            n = following[label]
            while n < len(chosen) and chosen[n] == passed[label]:
                places[n] = k
                n += 1
            following[label] = n
            passed[label] += 1
