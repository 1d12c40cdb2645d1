// Piecewise-bilinear warps of the unit square: a marginal over rows, then a conditional over columns.
//
// Source: Dupuy & Jakob 2018, section 4; the interpolation is that of Mitsuba's `Marginal2D`.
#pragma once

#include <algorithm>
#include <vector>

#include "directions.hpp"

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

// Cells of a grid, and the positions inside them, of the points of a tile.
struct Cells {
    int row[TILE], column[TILE];
    double y[TILE], x[TILE];

    INLINE void find(const double *at_x, const double *at_y, int rows, int columns) {
        for (int k = 0; k < TILE; ++k) {
            const Cell along = cell(at_x[k], columns), across = cell(at_y[k], rows);
            row[k] = across.index, y[k] = across.offset;
            column[k] = along.index, x[k] = along.offset;
        }
    }
};

// Increasing nodes of a conditional parameter.
class Axis {
  public:
    Axis() = default;
    explicit Axis(const Vector<const double> &nodes) : nodes(nodes.data(), nodes.data() + nodes.size()) {
        for (size_t k = 0; k + 1 < nodes.size(); ++k) inverse_widths.push_back(1.0 / (this->nodes[k + 1] - this->nodes[k]));
    }

    int size() const { return int(nodes.size()); }
    bool operator==(const Axis &other) const { return nodes == other.nodes; }

    // The nodes around each value of a tile, clamped, and the weight of the upper one. A node without weight is
    // replaced by the other one: its slice may hold NaN.
    INLINE void bracket(const double *values, int *lower, int *upper, double *weight) const {
        const int n = int(nodes.size());
        double below[TILE] = {};
        for (int m = 1; m < n - 1; ++m) {
            const double node = nodes[m];
            for (int k = 0; k < TILE; ++k) below[k] += node <= values[k] ? 1.0 : 0.0;
        }
        for (int k = 0; k < TILE; ++k) {
            const int low = int(below[k]);
            weight[k] = n == 1 ? 0.0 : clamped((values[k] - nodes[low]) * inverse_widths[low], 0.0, 1.0);
            lower[k] = low + (weight[k] == 1.0 ? 1 : 0);
            upper[k] = low + (weight[k] == 0.0 ? 0 : 1);
        }
    }

  private:
    std::vector<double> nodes, inverse_widths;
};

// The slices around the parameters of each pair of a tile, as indices into the flattened (P * T) axis, and shares that
// sum to 1: two of a file with one azimuth, four of others.
template <int N> struct Slices {
    int index[N][TILE];
    double share[N][TILE];

    INLINE void find(const Axis &phi_axis, const Axis &theta_axis, const double *phi, const double *theta) {
        int low[TILE], high[TILE];
        double t[TILE];
        theta_axis.bracket(theta, low, high, t);
        for (int k = 0; k < TILE; ++k) {
            index[0][k] = low[k], index[1][k] = high[k];
            share[0][k] = 1.0 - t[k], share[1][k] = t[k];
        }
        if constexpr (N == 4) {
            int left[TILE], right[TILE];
            double p[TILE];
            phi_axis.bracket(phi, left, right, p);
            const int n = theta_axis.size();
            for (int k = 0; k < TILE; ++k) {
                index[0][k] = left[k] * n + low[k], index[1][k] = left[k] * n + high[k];
                index[2][k] = right[k] * n + low[k], index[3][k] = right[k] * n + high[k];
                share[0][k] = (1.0 - p[k]) * (1.0 - t[k]), share[1][k] = (1.0 - p[k]) * t[k];
                share[2][k] = p[k] * (1.0 - t[k]), share[3][k] = p[k] * t[k];
            }
        }
    }
};

// Call f with the number of slices around an incident direction, as a constant.
template <class F> INLINE void with_slices(const Axis &phi_axis, const F &f) {
    if (phi_axis.size() > 1)
        f(std::integral_constant<int, 4>());
    else
        f(std::integral_constant<int, 2>());
}

// Position t in [0, 1] where the integral of the line from f0 to f1 over [0, t] is `area`: the root of
// f0 t + (f1 - f0) t^2 / 2 in the form that does not cancel.
INLINE double invert_linear(double f0, double f1, double area) {
    const double square = f0 * f0 + 2.0 * area * (f1 - f0), below = f0 + std::sqrt(square > 0.0 ? square : 0.0);
    return below > 0.0 ? clamped(2.0 * area / below, 0.0, 1.0) : 0.0;
}

// Densities on a grid of rows x columns, one per slice, and their cumulative sums.
class Warp {
  public:
    const Axis phi, theta;
    const int slices, rows, columns;

    Warp(Cube<const float> values, Vector<const double> phi_nodes, Vector<const double> theta_nodes)
        : phi(phi_nodes), theta(theta_nodes), slices(int(values.shape(0))), rows(int(values.shape(1))),
          columns(int(values.shape(2))), guided((columns - 2) / BLOCK) {
        require(phi.size() >= 1 && theta.size() >= 1 && slices == phi.size() * theta.size() && rows >= 2 && columns >= 2,
                "expected a slice of at least 2 x 2 nodes for each pair of azimuth and elevation");
        const size_t R = size_t(rows), C = size_t(columns);
        nodes.resize(slices * R * C * 3);
        sums.resize(slices * R * 2);
        for (int s = 0; s < slices; ++s) {
            const float *density = values.data() + s * R * C;
            double marginal = 0.0, before = 0.0;
            for (size_t i = 0; i < R; ++i, density += C) {
                float *node = nodes.data() + (s * R + i) * C * 3;
                double sum = 0.0;
                for (size_t j = 0; j < C; ++j, node += 3) {
                    if (j > 0) sum += 0.5 * (double(density[j - 1]) + density[j]);
                    if (j > 0 && j % BLOCK == 0 && j < C - 1) guides.push_back(float(sum));
                    node[0] = density[j], node[1] = float(sum), node[2] = float(sum - node[1]);
                }
                if (i > 0) marginal += 0.5 * (before + sum);
                before = sum;
                sums[(s * R + i) * 2] = sum, sums[(s * R + i) * 2 + 1] = marginal;
            }
            inverse_totals.push_back(1.0 / marginal);
        }
    }

    // Densities (n) of points of a tile; they integrate to 1 over the unit square.
    template <int N> INLINE void evaluate(const Slices<N> &around, const Cells &at, double *pdf) const {
        double cells[TILE][4];
        const Shares<N> shares(*this, around);
        for (int k = 0; k < TILE; ++k) shares.read_cell(k, at.row[k], at.column[k], at.y[k], cells[k]);
        for (int k = 0; k < TILE; ++k) pdf[k] = between(cells[k], at.x[k]);
    }

    // The uniform variates that `sample` maps to points of a tile, and the densities there.
    template <int N> INLINE void invert(const Slices<N> &around, const Cells &at, double *u, double *v, double *pdf) const {
        double cells[TILE][4], rows_around[TILE][4];
        const Shares<N> shares(*this, around);
        for (int k = 0; k < TILE; ++k) {
            shares.read_cell(k, at.row[k], at.column[k], at.y[k], cells[k]);
            shares.read_rows(k, at.row[k], rows_around[k]);
        }
        for (int k = 0; k < TILE; ++k) {
            const double *cell = cells[k], *row = rows_around[k], x = at.x[k], y = at.y[k];
            pdf[k] = between(cell, x);
            const double total = (1.0 - y) * row[0] + y * row[2], area = x * (cell[0] + 0.5 * x * (cell[3] - cell[0]));
            u[k] = total > 0.0 ? (area + (cell[1] + cell[2])) / total : 0.0;
            v[k] = y * (row[0] + 0.5 * y * (row[2] - row[0])) + row[1];
        }
    }

    // The points (x, y) of the uniform variates (u, v) of a tile, and the densities there.
    template <int N>
    INLINE void sample(const Slices<N> &around, const double *u, const double *v, double *x, double *y, double *pdf) const {
        double found[TILE][4], target[TILE], offset[TILE];
        float single_target[TILE], weights[2 * N][TILE];
        int row[TILE], column[TILE], first[2 * N][TILE];
        const Shares<N> shares(*this, around);
        for (int k = 0; k < TILE; ++k) row[k] = column[k] = 0, target[k] = inside(v[k]);
        for (int q = 0; q < N; ++q)
            for (int k = 0; k < TILE; ++k) first[q][k] = around.index[q][k] * rows * 2;
        bisect<N>(sums.data() + 3, 2, rows - 2, first, shares.weight, target, row);
        for (int k = 0; k < TILE; ++k) shares.read_rows(k, row[k], found[k]);
        for (int k = 0; k < TILE; ++k) {
            const double *rows_around = found[k];
            offset[k] = invert_linear(rows_around[0], rows_around[2], target[k] - rows_around[1]);
            target[k] = inside(u[k]) * ((1.0 - offset[k]) * rows_around[0] + offset[k] * rows_around[2]);
            single_target[k] = float(target[k]);
        }
        for (int q = 0; q < N; ++q)
            for (int k = 0; k < TILE; ++k) {
                first[2 * q][k] = (around.index[q][k] * rows + row[k]) * guided;
                first[2 * q + 1][k] = first[2 * q][k] + guided;
                weights[2 * q][k] = float((1.0 - offset[k]) * shares.weight[q][k]);
                weights[2 * q + 1][k] = float(offset[k] * shares.weight[q][k]);
            }
        // Sums of single precision, in guides and then between two of them, lead to the column or next to it.
        bisect<2 * N>(guides.data(), 1, guided, first, weights, single_target, column);
        const int inner = std::min(BLOCK - 1, columns - 2);
        for (int k = 0; k < TILE; ++k) column[k] = std::min(BLOCK * column[k], columns - 2 - inner);
        for (int q = 0; q < N; ++q)
            for (int k = 0; k < TILE; ++k) {
                first[2 * q][k] = (around.index[q][k] * rows + row[k]) * columns * 3;
                first[2 * q + 1][k] = first[2 * q][k] + columns * 3;
            }
        bisect<2 * N>(nodes.data() + 4, 3, inner, first, weights, single_target, column);
        for (int k = 0; k < TILE; ++k)
            column[k] = settle_column(shares, k, row[k], column[k], offset[k], target[k], found[k]);
        for (int k = 0; k < TILE; ++k) {
            const double *cell = found[k];
            const double t = invert_linear(cell[0], cell[3], target[k] - (cell[1] + cell[2]));
            pdf[k] = between(cell, t);
            x[k] = (column[k] + t) / (columns - 1), y[k] = (row[k] + offset[k]) / (rows - 1);
        }
    }

  private:
    static constexpr int BLOCK = 8; // columns between two guides, whose nodes are in two or three lines of the cache
    const int guided;               // guides of a row

    // Of each node its density, as the file has it, and the cumulative sum before it in two parts, whose sum has double
    // precision; so the four numbers from a node on are all that its cell takes.
    std::vector<float> nodes;  // (slice, row, column, 3)
    std::vector<double> sums;  // (slice, row, 2): of the row, and of the rows below it
    std::vector<float> guides; // (slice, row, column / BLOCK): cumulative sums of inner nodes
    std::vector<double> inverse_totals;

    static INLINE double inside(double variate) { return clamped(variate, 1e-12, 1.0 - 1e-12); }

    INLINE double between(const double *cell, double x) const {
        return ((1.0 - x) * cell[0] + x * cell[3]) * (double(rows - 1) * (columns - 1));
    }

    // Slices around the pairs of a tile, and what to multiply their numbers by.
    template <int N> struct Shares {
        const Warp &warp;
        const Slices<N> &around;
        double weight[N][TILE];

        INLINE Shares(const Warp &warp, const Slices<N> &around) : warp(warp), around(around) {
            const double *inverse = warp.inverse_totals.data();
            for (int q = 0; q < N; ++q)
                for (int k = 0; k < TILE; ++k) weight[q][k] = around.share[q][k] * inverse[around.index[q][k]];
        }

        // Of the cell of pair k at y between its rows: the density at its left, the cumulative sum in two parts, the
        // density at its right.
        INLINE void read_cell(int k, int row, int column, double y, double *out) const {
            double sum[4] = {};
            for (int q = 0; q < N; ++q) {
                const double low_weight = (1.0 - y) * weight[q][k], high_weight = y * weight[q][k];
                const float *low =
                    warp.nodes.data() + ((ptrdiff_t(around.index[q][k]) * warp.rows + row) * warp.columns + column) * 3;
                const float *high = low + ptrdiff_t(warp.columns) * 3;
                for (int c = 0; c < 4; ++c) sum[c] += low_weight * low[c] + high_weight * high[c];
            }
            for (int c = 0; c < 4; ++c) out[c] = sum[c];
        }

        // Of a row the sum, and that of the rows below it; then the same of the next row.
        INLINE void read_rows(int k, int row, double *out) const {
            double sum[4] = {};
            for (int q = 0; q < N; ++q) {
                const double *of_row = warp.sums.data() + (ptrdiff_t(around.index[q][k]) * warp.rows + row) * 2;
                for (int c = 0; c < 4; ++c) sum[c] += weight[q][k] * of_row[c];
            }
            for (int c = 0; c < 4; ++c) out[c] = sum[c];
        }
    };

    // Add to `found` how many of the `count` increasing sums from there on, blended from M places of a table, lie below a
    // target. All pairs take the same steps, so that they are compared four or eight at once.
    template <int M, class Real>
    static INLINE void bisect(const Real *table, int step, int count, const int (*first)[TILE], const Real (*weights)[TILE],
                              const Real *target, int *found) {
        while (count > 0) {
            const int half = (count + 1) / 2;
            for (int k = 0; k < TILE; ++k) {
                Real sum = 0;
                for (int q = 0; q < M; ++q) sum += weights[q][k] * table[first[q][k] + (found[k] + half - 1) * step];
                found[k] += sum < target[k] ? half : 0;
            }
            count -= half;
        }
    }

    // The column at or next to `column` whose conditional holds the target, and what `read_cell` has of it.
    template <int N>
    INLINE int settle_column(const Shares<N> &shares, int k, int row, int column, double y, double target, double *out) const {
        shares.read_cell(k, row, column, y, out);
        while (column > 0 && !(out[1] + out[2] < target)) shares.read_cell(k, row, --column, y, out);
        while (column < columns - 2 && out[1] + out[2] + 0.5 * (out[0] + out[3]) < target)
            shares.read_cell(k, row, ++column, y, out);
        return column;
    }
};

// Values of an (R, C) table, which must outlive it, at points of the unit square.
template <class Real> class Grid {
  public:
    explicit Grid(const Matrix<const Real> &table)
        : values(table.data()), rows(int(table.shape(0))), columns(int(table.shape(1))) {
        require(rows >= 2 && columns >= 2, "expected a table of at least 2 x 2 nodes");
        depends_on_y = !std::equal(values + columns, values + table.size(), values);
    }

    // Whether values depend on y: those of isotropic files do not.
    bool needs_y() const { return depends_on_y; }

    INLINE void interpolate(const double *x, const double *y, double *out) const {
        Cells at;
        at.find(x, y, rows, columns);
        if (!depends_on_y) {
            for (int k = 0; k < TILE; ++k) out[k] = along(at.column[k], at.x[k]);
            return;
        }
        for (int k = 0; k < TILE; ++k) {
            const ptrdiff_t low = ptrdiff_t(at.row[k]) * columns + at.column[k];
            out[k] = (1.0 - at.y[k]) * along(low, at.x[k]) + at.y[k] * along(low + columns, at.x[k]);
        }
    }

  private:
    const Real *values;
    int rows, columns;
    bool depends_on_y;

    INLINE double along(ptrdiff_t node, double x) const { return (1.0 - x) * values[node] + x * values[node + 1]; }
};
