// Piecewise-bilinear warps of the unit square: a marginal over rows, then a conditional over columns.
//
// Source: Dupuy & Jakob 2018, section 4; the interpolation is that of Mitsuba's `Marginal2D`.
#pragma once

#include "common.hpp"

// Clamps that send NaN to the lower bound, so that an index of it lies inside its table.
INLINE double clamped(double x, double low, double high) {
    x = x > low ? x : low;
    return x < high ? x : high;
}

struct Cell {
    int index;
    double offset;
};

// The grid cell that holds a coordinate in [0, 1] on n >= 2 nodes, and the position inside it.
INLINE Cell cell(double coordinate, int n) {
    const double scaled = clamped(coordinate, 0.0, 1.0) * (n - 1);
    int i = int(scaled);
    i = i < n - 2 ? i : n - 2;
    return {i, scaled - i};
}

// Index k with nodes[k] <= value < nodes[k + 1], clamped, and the weight of node k + 1.
INLINE Cell bracket(const double *nodes, int n, double value) {
    if (n == 1) return {0, 0.0};
    int low = 0, high = n - 1;
    while (high - low > 1) {
        const int middle = (low + high) / 2;
        if (nodes[middle] <= value)
            low = middle;
        else
            high = middle;
    }
    return {low, clamped((value - nodes[low]) / (nodes[low + 1] - nodes[low]), 0.0, 1.0)};
}

// Four parameter slices around (phi, theta), as indices into the flattened (P * T) axis, and weights that sum to 1.
struct Blend {
    int slice[4];
    double weight[4];
    bool has_two_azimuths;
};

// Densities and their cumulative sums on a grid of rows x columns, one per pair of conditional parameters.
struct WarpView {
    const double *data, *conditional, *marginal; // (P * T, R, C) twice, (P * T, R)
    const double *phi_nodes, *theta_nodes;
    int n_phi, n_theta, rows, columns;

    INLINE Blend blend(double phi, double theta) const {
        const Cell p = bracket(phi_nodes, n_phi, phi), t = bracket(theta_nodes, n_theta, theta);
        const int dp = n_phi > 1 ? n_theta : 0, dt = n_theta > 1 ? 1 : 0;
        const int k = p.index * n_theta + t.index;
        Blend out{
            {k, k + dt, k + dp, k + dp + dt},
            {(1 - p.offset) * (1 - t.offset), (1 - p.offset) * t.offset, p.offset * (1 - t.offset),
             p.offset * t.offset},
            p.offset != 0.0};
        return out;
    }

    INLINE double at(const double *table, const Blend &b, ptrdiff_t stride, ptrdiff_t node) const {
        double v = b.weight[0] * table[b.slice[0] * stride + node] + b.weight[1] * table[b.slice[1] * stride + node];
        if (b.has_two_azimuths)
            v += b.weight[2] * table[b.slice[2] * stride + node] + b.weight[3] * table[b.slice[3] * stride + node];
        return v;
    }

    INLINE double node(const double *table, const Blend &b, int i, int j) const {
        return at(table, b, ptrdiff_t(rows) * columns, ptrdiff_t(i) * columns + j);
    }

    INLINE double below_row(const Blend &b, int i) const { return at(marginal, b, rows, i); }

    // Densities at the two columns of a cell, at ty between its rows.
    INLINE void sides(const Blend &b, int i, int j, double ty, double &c0, double &c1) const {
        c0 = (1 - ty) * node(data, b, i, j) + ty * node(data, b, i + 1, j);
        c1 = (1 - ty) * node(data, b, i, j + 1) + ty * node(data, b, i + 1, j + 1);
    }

    INLINE double scale() const { return double(rows - 1) * (columns - 1); }

    // Density at (x, y); integrates to 1 over the unit square.
    INLINE double density(const Blend &b, double x, double y) const {
        const Cell column = cell(x, columns), row = cell(y, rows);
        double c0, c1;
        sides(b, row.index, column.index, row.offset, c0, c1);
        return ((1 - column.offset) * c0 + column.offset * c1) * scale();
    }

    // The uniform variates that `sample` maps to a point of a cell, and the density there.
    INLINE void invert(const Blend &b, Cell row, Cell column, double &u, double &v, double &pdf) const {
        const int i = row.index, j = column.index;
        const double ty = row.offset, tx = column.offset;
        double c0, c1;
        sides(b, i, j, ty, c0, c1);
        pdf = ((1 - tx) * c0 + tx * c1) * scale();
        const double below = (1 - ty) * node(conditional, b, i, j) + ty * node(conditional, b, i + 1, j);
        const double r0 = node(conditional, b, i, columns - 1), r1 = node(conditional, b, i + 1, columns - 1);
        const double total = (1 - ty) * r0 + ty * r1;
        u = total > 0.0 ? (tx * (c0 + 0.5 * tx * (c1 - c0)) + below) / total : 0.0;
        v = ty * (r0 + 0.5 * ty * (r1 - r0)) + below_row(b, i);
    }

    // The point (x, y) of uniform variates (u, v), and the density there.
    INLINE void sample(const Blend &b, double u, double v, double &x, double &y, double &pdf) const;
};

// Position t in [0, 1] where the integral of the line from f0 to f1 over [0, t] is `area`.
INLINE double invert_linear(double f0, double f1, double area) {
    constexpr double flat = 1e-4; // relative slope under which a linear density is treated as constant
    double t;
    if (std::abs(f0 - f1) < flat * (f0 + f1) || f0 + f1 <= 0.0) {
        t = f0 + f1 > 0.0 ? 2.0 * area / (f0 + f1) : 0.0;
    } else {
        const double square = f0 * f0 - 2.0 * area * (f0 - f1);
        t = (f0 - std::sqrt(square > 0.0 ? square : 0.0)) / (f0 - f1);
    }
    return clamped(t, 0.0, 1.0);
}

INLINE void WarpView::sample(const Blend &b, double u, double v, double &x, double &y, double &pdf) const {
    v = clamped(v, 1e-12, 1.0 - 1e-12);
    u = clamped(u, 1e-12, 1.0 - 1e-12);
    int low = 0, high = rows - 1;
    while (high - low > 1) {
        const int middle = (low + high) / 2;
        (below_row(b, middle) < v ? low : high) = middle;
    }
    const int i = low;
    const double r0 = node(conditional, b, i, columns - 1), r1 = node(conditional, b, i + 1, columns - 1);
    const double ty = invert_linear(r0, r1, v - below_row(b, i));
    const double target = u * ((1 - ty) * r0 + ty * r1);
    low = 0, high = columns - 1;
    while (high - low > 1) {
        const int middle = (low + high) / 2;
        const double reached =
            (1 - ty) * node(conditional, b, i, middle) + ty * node(conditional, b, i + 1, middle);
        (reached < target ? low : high) = middle;
    }
    const int j = low;
    const double below = (1 - ty) * node(conditional, b, i, j) + ty * node(conditional, b, i + 1, j);
    double c0, c1;
    sides(b, i, j, ty, c0, c1);
    const double tx = invert_linear(c0, c1, target - below);
    pdf = ((1 - tx) * c0 + tx * c1) * scale();
    x = (j + tx) / (columns - 1);
    y = (i + ty) / (rows - 1);
}

// Value of an (R, C) table at a point of one of its cells.
INLINE double bilinear(const double *table, int columns, Cell row, Cell column) {
    const double *low = table + ptrdiff_t(row.index) * columns + column.index, *high = low + columns;
    const double tx = column.offset, ty = row.offset;
    return (1 - ty) * ((1 - tx) * low[0] + tx * low[1]) + ty * ((1 - tx) * high[0] + tx * high[1]);
}

// A view of checked tables, which must outlive it.
inline WarpView warp_view(const Cube<const double> &data, const Cube<const double> &conditional,
                          const Matrix<const double> &marginal, const Vector<const double> &phi,
                          const Vector<const double> &theta) {
    const size_t slices = phi.size() * theta.size(), rows = data.shape(1), columns = data.shape(2);
    require(slices >= 1 && data.shape(0) == slices && conditional.shape(0) == slices && marginal.shape(0) == slices,
            "expected a slice for each pair of azimuth and elevation");
    require(rows >= 2 && columns >= 2 && conditional.shape(1) == rows && conditional.shape(2) == columns &&
                marginal.shape(1) == rows,
            "expected densities and cumulative sums on one grid of at least 2 x 2 nodes");
    return {data.data(),     conditional.data(), marginal.data(), phi.data(),  theta.data(),
            int(phi.size()), int(theta.size()),  int(rows),       int(columns)};
}
