"""The report on surfaces of second order."""

from bench import surfaces


def test_operations_counted_are_those_of_the_formulas():
    counts = surfaces.count_all()
    for order in range(1, 5):
        row = counts[order]
        explicit = (order + 1) * (order + 2) // 2
        assert row["range explicit"] == {"tables": explicit, "operations": 5 * explicit}
        standard = explicit + (2 * order + 1) * (2 * order + 2) // 2 - 1
        assert row["standard explicit"] == {"tables": standard, "operations": 5 * standard - 1}
    assert [counts[2][f"{form} implicit"]["operations"] for form in ("standard", "range")] == [169, 100]
    assert [counts[2][f"{form} explicit"]["operations"] for form in ("standard", "range")] == [99, 30]


def test_curvatures_of_the_other_methods_are_right_without_noise():
    found = surfaces.accuracy(2)
    for row in found.values():
        for name in ("range, q(u, v)", "Z(X, Y)", "in principal components"):
            assert abs(row[name][0]) < 3.0
