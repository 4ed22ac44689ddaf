"""A small symmetric solve, unrolled, in components: no loop is left in what is generated from it."""


def solve(m, rhs):
    """x in A x = rhs for a symmetric positive definite A given by its lower triangle (LDL^T, unrolled)."""
    size = len(rhs)
    # LDL^T and not Cholesky: no square root, and the reciprocal of a pivot is reckoned once for a whole column
    low = [[None] * size for _ in range(size)]
    inv = [None] * size
    for j in range(size):
        pivot = m[j][j]
        for k in range(j):
            pivot = pivot - low[j][k][0] * low[j][k][1]
        inv[j] = 1.0 / pivot
        for i in range(j + 1, size):
            value = m[i][j]
            for k in range(j):
                value = value - low[i][k][1] * low[j][k][0]
            # the product L_ij D_j is wanted twice below, so both stand in the table
            low[i][j] = (value * inv[j], value)  # (L_ij, L_ij D_j)
    x = list(rhs)
    # L y = b, then D L^T x = y. No pivoting: A is a mass matrix plus damping, positive definite, and an exchange of rows would
    # depend on values, which straight-line code for a whole batch cannot do
    for i in range(size):
        for k in range(i):
            x[i] = x[i] - low[i][k][0] * x[k]
    for i in reversed(range(size)):
        x[i] = x[i] * inv[i]
        for k in range(i + 1, size):
            x[i] = x[i] - low[k][i][0] * x[k]
    return x
