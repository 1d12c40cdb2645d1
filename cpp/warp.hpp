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
          columns(int(values.shape(2))) {
        require(phi.size() >= 1 && theta.size() >= 1 && slices == phi.size() * theta.size() && rows >= 2 && columns >= 2,
                "expected a slice of at least 2 x 2 nodes for each pair of azimuth and elevation");
        const size_t R = size_t(rows), C = size_t(columns);
        coarse_columns = padded((C - 2) / BLOCK), coarse_rows = padded((R - 2) / BLOCK), fine_rows = padded(R - 2);
        nodes.resize(slices * R * C * 3 + 3 * BLOCK);
        sums.resize(slices * R * 2);
        column_guides.resize(slices * R * coarse_columns, BEYOND);
        row_guides.resize(slices * (coarse_rows + fine_rows), BEYOND);
        for (int s = 0; s < slices; ++s) {
            const float *density = values.data() + s * R * C;
            double marginal = 0.0, before = 0.0;
            for (size_t i = 0; i < R; ++i, density += C) {
                float *node = nodes.data() + (s * R + i) * C * 3;
                double sum = 0.0;
                for (size_t j = 0; j < C; ++j, node += 3) {
                    if (j > 0) sum += 0.5 * (double(density[j - 1]) + density[j]);
                    node[0] = density[j], node[1] = float(sum), node[2] = float(sum - node[1]);
                    if (j > 0 && j % BLOCK == 0 && j < C - 1)
                        column_guides[(s * R + i) * coarse_columns + j / BLOCK - 1] = node[1];
                }
                if (i > 0) marginal += 0.5 * (before + sum);
                before = sum;
                sums[(s * R + i) * 2] = sum, sums[(s * R + i) * 2 + 1] = marginal;
                float *guide = row_guides.data() + s * (coarse_rows + fine_rows);
                if (i > 0 && i < R - 1) guide[coarse_rows + i - 1] = float(marginal);
                if (i > 0 && i < R - 1 && i % BLOCK == 0) guide[i / BLOCK - 1] = float(marginal);
            }
            inverse_totals.push_back(1.0 / marginal);
        }
    }

    // Densities (n) of points of a tile; they integrate to 1 over the unit square.
    template <int N> INLINE void evaluate(const Slices<N> &around, const Cells &at, double *pdf) const {
        double cells[TILE][4];
        for (int k = 0; k < TILE; ++k) read_cell(around, k, at.row[k], at.column[k], at.y[k], cells[k]);
        for (int k = 0; k < TILE; ++k) pdf[k] = between(cells[k], at.x[k]);
    }

    // The uniform variates that `sample` maps to points of a tile, and the densities there.
    template <int N> INLINE void invert(const Slices<N> &around, const Cells &at, double *u, double *v, double *pdf) const {
        double cells[TILE][4], rows_around[TILE][4];
        for (int k = 0; k < TILE; ++k) {
            read_cell(around, k, at.row[k], at.column[k], at.y[k], cells[k]);
            read_rows(around, k, at.row[k], rows_around[k]);
        }
        for (int k = 0; k < TILE; ++k) {
            const double *cell = cells[k], *row = rows_around[k], x = at.x[k], y = at.y[k];
            pdf[k] = between(cell, x);
            const double total = (1.0 - y) * row[0] + y * row[2], area = x * (cell[0] + 0.5 * x * (cell[3] - cell[0]));
            u[k] = total > 0.0 ? (area + (cell[1] + cell[2])) / total : 0.0;
            v[k] = y * (row[0] + 0.5 * y * (row[2] - row[0])) + row[1];
        }
    }

    // The points (x, y) of n uniform variates (u, v) of a tile, and the densities there.
    template <int N>
    INLINE void sample(const Slices<N> &around, const double *u, const double *v, int n, double *x, double *y,
                       double *pdf) const {
        double found[TILE][4], target[TILE], offset[TILE];
        int row[TILE], column[TILE];
        for (int k = n; k < TILE; ++k) row[k] = column[k] = 0, found[k][0] = found[k][1] = found[k][2] = found[k][3] = 1.0;
        for (int k = 0; k < n; ++k) row[k] = find_row(around, k, inside(v[k]), found[k]);
        for (int k = 0; k < TILE; ++k) {
            const double *rows_around = found[k];
            offset[k] = invert_linear(rows_around[0], rows_around[2], inside(v[k]) - rows_around[1]);
            target[k] = inside(u[k]) * ((1.0 - offset[k]) * rows_around[0] + offset[k] * rows_around[2]);
        }
        for (int k = 0; k < n; ++k) column[k] = find_block(around, k, row[k], offset[k], target[k]);
        for (int k = 0; k < n; ++k) column[k] = find_column(around, k, row[k], column[k], offset[k], target[k], found[k]);
        for (int k = 0; k < TILE; ++k) {
            const double *cell = found[k];
            const double t = invert_linear(cell[0], cell[3], target[k] - (cell[1] + cell[2]));
            pdf[k] = between(cell, t);
            x[k] = (column[k] + t) / (columns - 1), y[k] = (row[k] + offset[k]) / (rows - 1);
        }
    }

  private:
    static constexpr int BLOCK = 8;         // nodes between two of a guide
    static constexpr float BEYOND = 1e30f;  // in guides behind the last node: no sum reaches it

    // Of each node its density, as the file has it, and the cumulative sum before it in two parts, whose sum has double
    // precision; so the four numbers from a node on are all that its cell takes.
    std::vector<float> nodes;    // (slice, row, column, 3)
    std::vector<double> sums;    // (slice, row, 2): of the row, and of the rows below it
    std::vector<double> inverse_totals;
    // Cumulative sums of inner nodes: every eighth one of a row; every eighth row, then every row.
    std::vector<float> column_guides, row_guides;
    size_t coarse_columns, coarse_rows, fine_rows;

    static size_t padded(size_t n) { return (n + BLOCK - 1) / BLOCK * BLOCK; }

    static INLINE double inside(double variate) { return clamped(variate, 1e-12, 1.0 - 1e-12); }

    INLINE double between(const double *cell, double x) const {
        return ((1.0 - x) * cell[0] + x * cell[3]) * (double(rows - 1) * (columns - 1));
    }

    template <int N> INLINE double share(const Slices<N> &around, int q, int k) const {
        return around.share[q][k] * inverse_totals[around.index[q][k]];
    }

    // Of the cell of pair k at y between its rows: the density at its left, the cumulative sum in two parts, the density
    // at its right.
    template <int N> INLINE void read_cell(const Slices<N> &around, int k, int row, int column, double y, double *out) const {
        double sum[4] = {};
        for (int q = 0; q < N; ++q) {
            const double weight = share(around, q, k), low_weight = (1.0 - y) * weight, high_weight = y * weight;
            const float *low = nodes.data() + ((ptrdiff_t(around.index[q][k]) * rows + row) * columns + column) * 3;
            const float *high = low + ptrdiff_t(columns) * 3;
            for (int c = 0; c < 4; ++c) sum[c] += low_weight * low[c] + high_weight * high[c];
        }
        for (int c = 0; c < 4; ++c) out[c] = sum[c];
    }

    // Of a row the sum, and that of the rows below it; then the same of the next row.
    template <int N> INLINE void read_rows(const Slices<N> &around, int k, int row, double *out) const {
        double sum[4] = {};
        for (int q = 0; q < N; ++q) {
            const double weight = share(around, q, k);
            const double *of_row = sums.data() + (ptrdiff_t(around.index[q][k]) * rows + row) * 2;
            for (int c = 0; c < 4; ++c) sum[c] += weight * of_row[c];
        }
        for (int c = 0; c < 4; ++c) out[c] = sum[c];
    }

    // How many of a guide's nodes lie below a target, over all its blocks or in one.
    template <int M> static INLINE int count_below(const float *const *guides, const float *weights, size_t length, float target) {
        int count = 0;
        for (size_t start = 0; start < length; start += BLOCK)
            for (int e = 0; e < BLOCK; ++e) {
                float sum = 0.0f;
                for (int q = 0; q < M; ++q) sum += weights[q] * guides[q][start + e];
                count += sum < target;
            }
        return count;
    }

    // The row whose marginal holds v, and what `read_rows` has of it. Guides of single precision lead to it or next to it.
    template <int N> INLINE int find_row(const Slices<N> &around, int k, double v, double *out) const {
        const float *guides[N];
        float weights[N];
        for (int q = 0; q < N; ++q) {
            guides[q] = row_guides.data() + around.index[q][k] * (coarse_rows + fine_rows);
            weights[q] = float(share(around, q, k));
        }
        int row = BLOCK * count_below<N>(guides, weights, coarse_rows, float(v));
        for (int q = 0; q < N; ++q) guides[q] += coarse_rows + row;
        row += count_below<N>(guides, weights, fine_rows > 0 ? BLOCK : 0, float(v));
        read_rows(around, k, row, out);
        while (row > 0 && !(out[1] < v)) read_rows(around, k, --row, out);
        while (row < rows - 2 && out[3] < v) read_rows(around, k, ++row, out);
        return row;
    }

    // Of the pair's slices two rows each, of `width` numbers, and their weights at y between the rows.
    template <int N>
    INLINE void rows_at(const Slices<N> &around, int k, int row, double y, const std::vector<float> &table, size_t width,
                        const float **of_rows, float *weights) const {
        for (int q = 0; q < N; ++q) {
            const double weight = share(around, q, k);
            weights[2 * q] = float((1.0 - y) * weight), weights[2 * q + 1] = float(y * weight);
            of_rows[2 * q] = table.data() + (ptrdiff_t(around.index[q][k]) * rows + row) * width;
            of_rows[2 * q + 1] = of_rows[2 * q] + width;
        }
    }

    // The first column of the block whose conditional at y between two rows holds a target, by guides.
    template <int N> INLINE int find_block(const Slices<N> &around, int k, int row, double y, double target) const {
        const float *of_rows[2 * N];
        float weights[2 * N];
        rows_at(around, k, row, y, column_guides, coarse_columns, of_rows, weights);
        const int start = BLOCK * count_below<2 * N>(of_rows, weights, coarse_columns, float(target));
        rows_at(around, k, row, y, nodes, size_t(columns) * 3, of_rows, weights);
        for (int q = 0; q < 2 * N; ++q) prefetch(of_rows[q] + 3 * start), prefetch(of_rows[q] + 3 * (start + BLOCK));
        return start;
    }

    // The column in a block or next to it whose conditional holds the target, and what `read_cell` has of it.
    template <int N>
    INLINE int find_column(const Slices<N> &around, int k, int row, int start, double y, double target, double *out) const {
        const float *of_rows[2 * N];
        float weights[2 * N], block[3 * BLOCK];
        rows_at(around, k, row, y, nodes, size_t(columns) * 3, of_rows, weights);
        for (int e = 0; e < 3 * BLOCK; ++e) {
            float sum = 0.0f;
            for (int q = 0; q < 2 * N; ++q) sum += weights[q] * of_rows[q][3 * (start + 1) + e];
            block[e] = sum;
        }
        float reached[BLOCK];
        for (int e = 0; e < BLOCK; ++e) reached[e] = block[3 * e + 1];
        for (int e = 0; e < BLOCK; ++e) reached[e] = e < columns - 2 - start ? reached[e] : BEYOND;
        int column = start;
        for (int e = 0; e < BLOCK; ++e) column += reached[e] < float(target);
        read_cell(around, k, row, column, y, out);
        while (column > 0 && !(out[1] + out[2] < target)) read_cell(around, k, row, --column, y, out);
        while (column < columns - 2 && out[1] + out[2] + 0.5 * (out[0] + out[3]) < target)
            read_cell(around, k, row, ++column, y, out);
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
