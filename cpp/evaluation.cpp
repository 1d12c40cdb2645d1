// Measured BRDFs at pairs of directions: all bands of a pair from one inversion of a warp; sampling; weighted sums.
//
// Pairs are handled in tiles that stay in the cache. Formulas run over the pairs of a tile, four or eight at once; the
// corners of a cell are read pair by pair, in vectors of the numbers that lie side by side; so are many bands.

#include <nanobind/stl/vector.h>

#include <algorithm>
#include <cstring>
#include <vector>

#include "directions.hpp"
#include "kernels.hpp"
#include "warp.hpp"

using namespace nanobind::literals;

namespace {

constexpr int LANES = 8; // values that a loop over bands handles at once
constexpr int FEW = 4;   // bands that are read together, as those of RGB files

// The tables of a file; arrays and warp live as long as it does.
struct Tables {
    bool jacobian;
    Matrix<const float> ndf_array, sigma_array;
    Table4<const float> spectra_array;

    const Warp &warp;
    Grid<float> ndf, sigma;
    std::vector<float> few; // the spectra with FEW numbers a node, where there are fewer bands
    const float *spectra;   // (slice, row, column, band)
    int rows, columns, bands, stride;

    Tables(bool jacobian, Matrix<const float> ndf, Matrix<const float> sigma, const Warp &warp, Table4<const float> values)
        : jacobian(jacobian), ndf_array(ndf), sigma_array(sigma), spectra_array(values), warp(warp), ndf(ndf),
          sigma(sigma), spectra(values.data()), rows(int(values.shape(1))), columns(int(values.shape(2))),
          bands(int(values.shape(3))), stride(std::max(bands, FEW)) {
        require(int(values.shape(0)) == warp.slices, "expected a slice for each pair of azimuth and elevation");
        require(rows >= 2 && columns >= 2 && bands >= 1, "expected spectra on at least 2 x 2 nodes");
        if (bands >= FEW) return;
        few.resize(values.size() / bands * FEW);
        for (size_t k = 0; k < values.size(); ++k) few[k / bands * FEW + k % bands] = spectra[k];
        spectra = few.data();
        spectra_array = {};
    }

    // Whether anything but the half vectors depends on the incident azimuth.
    bool needs_azimuth() const { return warp.phi.size() > 1 || (jacobian && sigma.needs_y()); }

    // Whether slices and cells of the warp are those of another file.
    bool shares_axes(const Tables &other) const {
        return warp.phi == other.warp.phi && warp.theta == other.warp.theta && warp.rows == other.warp.rows &&
               warp.columns == other.warp.columns;
    }

    INLINE const float *node(int slice, int i, int j) const {
        return spectra + ((ptrdiff_t(slice) * rows + i) * columns + j) * stride;
    }

    // f cos(theta_o), or f, over the stored values of a tile.
    INLINE void scale(const double *theta_i, const double *phi_i, const double *x, const double *y, double *out) const {
        if (!jacobian) {
            std::fill_n(out, TILE, 1.0);
            return;
        }
        double at_x[TILE], at_y[TILE], area[TILE];
        for (int k = 0; k < TILE; ++k) at_x[k] = theta_to_u(theta_i[k]), at_y[k] = phi_to_u(phi_i[k]);
        ndf.interpolate(x, y, out);
        sigma.interpolate(at_x, at_y, area);
        for (int k = 0; k < TILE; ++k) out[k] /= 4.0 * area[k];
    }
};

// Corners of the cells of a tile in the spectra of a file, and the weights of each slice's four.
template <class Real, int N> struct Corners {
    const float *low[N][TILE]; // the left one of the lower row
    Real weight[4 * N][TILE];

    INLINE void weigh(const Tables &tables, const Slices<N> &around, const double *u, const double *v, const double *scale) {
        Cells at;
        at.find(u, v, tables.rows, tables.columns);
        for (int q = 0; q < N; ++q) {
            for (int k = 0; k < TILE; ++k) low[q][k] = tables.node(around.index[q][k], at.row[k], at.column[k]);
            for (int k = 0; k < TILE; ++k) {
                const double share = around.share[q][k] * scale[k], x = at.x[k], y = at.y[k];
                weight[4 * q][k] = Real(share * ((1.0 - y) * (1.0 - x)));
                weight[4 * q + 1][k] = Real(share * ((1.0 - y) * x));
                weight[4 * q + 2][k] = Real(share * (y * (1.0 - x)));
                weight[4 * q + 3][k] = Real(share * (y * x));
            }
        }
    }

    // Read FEW bands of pair k.
    INLINE void read_few(ptrdiff_t row_size, int k, Real *values) const {
        Real sum[FEW] = {};
        for (int q = 0; q < N; ++q) {
            const float *p = low[q][k], *high = p + row_size;
            for (int b = 0; b < FEW; ++b)
                sum[b] += (weight[4 * q][k] * p[b] + weight[4 * q + 1][k] * p[FEW + b]) +
                          (weight[4 * q + 2][k] * high[b] + weight[4 * q + 3][k] * high[FEW + b]);
        }
        for (int b = 0; b < FEW; ++b) values[b] = sum[b];
    }
};

// The corners of one pair, whose rows of many bands are added up.
template <class Real, int N> struct Streams {
    const float *p[4 * N];
    Real w[4 * N];

    INLINE Streams(const Tables &tables, const Corners<Real, N> &corners, int k) {
        for (int q = 0; q < N; ++q) {
            p[4 * q] = corners.low[q][k], p[4 * q + 1] = p[4 * q] + tables.stride;
            p[4 * q + 2] = p[4 * q] + ptrdiff_t(tables.columns) * tables.stride, p[4 * q + 3] = p[4 * q + 2] + tables.stride;
            for (int c = 0; c < 4; ++c) w[4 * q + c] = corners.weight[4 * q + c][k];
        }
    }

    INLINE Real at(int b) const {
        Real sum = 0;
        for (int s = 0; s < 4 * N; s += 4)
            sum += (w[s] * p[s][b] + w[s + 1] * p[s + 1][b]) + (w[s + 2] * p[s + 2][b] + w[s + 3] * p[s + 3][b]);
        return sum;
    }
};

// Call f(b) for b = 0, ..., n - 1 in vectors; the last vector overlaps the one before it.
template <class F> INLINE void over_bands(int n, const F &f) {
    if (n < LANES) {
        for (int b = 0; b < n; ++b) f(b);
        return;
    }
    for (int start = 0;;) {
        for (int lane = 0; lane < LANES; ++lane) f(start + lane);
        if (start == n - LANES) break;
        start = std::min(start + LANES, n - LANES);
    }
}

template <class Real, int N> INLINE void read(const Streams<Real, N> &s, int n, Real *RESTRICT row) {
    const Streams<Real, N> local = s;
    over_bands(n, [&](int b) INLINE_LAMBDA { row[b] = local.at(b); });
}

// Read two pairs whose cells are the same.
template <class Real, int N>
INLINE void read_two(const Streams<Real, N> &s, const Streams<Real, N> &next, int n, Real *RESTRICT row,
                     Real *RESTRICT next_row) {
    const Streams<Real, N> local = s;
    Streams<Real, N> other = next;
    for (int q = 0; q < 4 * N; ++q) other.p[q] = local.p[q];
    over_bands(n, [&](int b) INLINE_LAMBDA {
        const Real first = local.at(b), second = other.at(b);
        row[b] = first;
        next_row[b] = second;
    });
}

// Rows of bands of a tile: `row_of(k)` is where those of pair k go, and `done(k)` is called when they are there. Pairs
// that are not above the horizon are left out.
template <class Real, int N, class RowOf, class Done>
INLINE void read_tile(const Tables &tables, const Corners<Real, N> &corners, const double *cos_o, int n, const RowOf &row_of,
                      const Done &done) {
    for (int k = 0; k < n; ++k) {
        if (!(cos_o[k] > 0.0)) continue;
        const Streams<Real, N> here(tables, corners, k);
        const int next = k + 1;
        if (next < n && cos_o[next] > 0.0) {
            const Streams<Real, N> ahead(tables, corners, next);
            bool is_same = N == 2; // sixteen streams and two rows are more than there are registers
            for (int q = 0; q < N; ++q) is_same &= ahead.p[4 * q] == here.p[4 * q];
            if (is_same) {
                read_two(here, ahead, tables.bands, row_of(k), row_of(next));
                done(k);
                done(++k);
                continue;
            }
            for (int q = 0; q < 4 * N; ++q) prefetch(ahead.p[q]), prefetch(ahead.p[q] + 16);
        }
        read(here, tables.bands, row_of(k));
        done(k);
    }
}

// The slices and cells of a tile in the warp of a file.
template <int N> struct Placed {
    Slices<N> around;
    Cells at;

    INLINE void place(const Warp &warp, const Located &pairs) {
        around.find(warp.phi, warp.theta, pairs.phi_i, pairs.theta_i);
        at.find(pairs.x, pairs.y, warp.rows, warp.columns);
    }

    // The corners of f, or without `divide` of f cos(theta_o).
    template <class Real>
    INLINE void weigh(const Tables &tables, const Located &pairs, bool divide, Corners<Real, N> &corners) const {
        double u[TILE], v[TILE], pdf[TILE], scale[TILE];
        tables.warp.invert(around, at, u, v, pdf);
        tables.scale(pairs.theta_i, pairs.phi_i, pairs.x, pairs.y, scale);
        if (divide)
            for (int k = 0; k < TILE; ++k) scale[k] /= pairs.cos_o[k] > 0.0 ? pairs.cos_o[k] : 1.0;
        corners.weigh(tables, around, u, v, scale);
    }
};

// All bands of a tile of n located pairs into out (n, B).
template <class Real> INLINE void evaluate_tile(const Tables &tables, const Located &pairs, int n, bool divide, Real *out) {
    const int bands = tables.bands;
    with_slices(tables.warp.phi, [&](auto count) INLINE_LAMBDA {
        Placed<count> placed;
        Corners<Real, count> corners;
        placed.place(tables.warp, pairs);
        placed.weigh(tables, pairs, divide, corners);
        if (bands <= FEW) {
            // FEW numbers are written where the tile has room for them; the next pair overwrites what is too much.
            const ptrdiff_t row_size = ptrdiff_t(tables.columns) * FEW;
            for (int k = 0; k < n; ++k) {
                Real values[FEW];
                corners.read_few(row_size, k, values);
                for (int b = 0; b < FEW; ++b) values[b] = pairs.cos_o[k] > 0.0 ? values[b] : Real(0);
                if (ptrdiff_t(k) * bands + FEW <= ptrdiff_t(n) * bands)
                    std::memcpy(out + ptrdiff_t(k) * bands, values, sizeof(values));
                else
                    std::copy_n(values, bands, out + ptrdiff_t(k) * bands);
            }
            return;
        }
        for (int k = 0; k < n; ++k)
            if (!(pairs.cos_o[k] > 0.0)) std::fill_n(out + ptrdiff_t(k) * bands, bands, Real(0));
        read_tile(
            tables, corners, pairs.cos_o, n, [&](int k) INLINE_LAMBDA { return out + ptrdiff_t(k) * bands; },
            [](int) INLINE_LAMBDA {});
    });
}

// Rows of numbers of Python, in single or double precision: one for each pair, or one for all.
using Arrays = nb::ndarray<nb::ro, nb::ndim<2>, nb::c_contig, nb::device::cpu>;

// Results in single or double precision.
template <class Shape> using Results = nb::ndarray<Shape, nb::c_contig, nb::device::cpu>;

struct Sink {
    void *data;
    bool is_single;

    template <class Shape> explicit Sink(const Results<Shape> &array) : data(array.data()), is_single(array.dtype() == nb::dtype<float>()) {
        require(is_single || array.dtype() == nb::dtype<double>(), "expected results in single or double precision");
    }

    INLINE void set(ptrdiff_t index, double value) const {
        if (is_single)
            static_cast<float *>(data)[index] = float(value);
        else
            static_cast<double *>(data)[index] = value;
    }
};

Rows rows_of(const Arrays &array, size_t count, size_t width) {
    const bool is_single = array.dtype() == nb::dtype<float>();
    require(is_single || array.dtype() == nb::dtype<double>(), "expected single or double precision");
    require(array.shape(1) == width && (array.shape(0) == count || array.shape(0) == 1),
            "expected a row for each result, or one for all");
    return {array.data(), is_single, array.shape(0) == 1 ? 0 : ptrdiff_t(width)};
}

// Call f with the start and the number of pairs of each tile.
template <class F> INLINE void over_tiles(ptrdiff_t count, const F &f) {
    for (ptrdiff_t start = 0; start < count; start += TILE) f(start, int(std::min<ptrdiff_t>(TILE, count - start)));
}

// Locate pairs tile by tile and call f with each tile; return whether all directions are unit vectors.
template <class F>
INLINE bool over_pairs(const Rows &wi, const Rows &wo, ptrdiff_t count, Symmetry symmetry, bool needs_azimuth, const F &f) {
    bool are_units = true;
    fastest([&]() INLINE_LAMBDA {
        Directions i, o;
        Located pairs;
        over_tiles(count, [&](ptrdiff_t start, int n) INLINE_LAMBDA {
            are_units &= i.load(wi, start, n) & o.load(wo, start, n);
            pairs.locate(i, o, symmetry, needs_azimuth);
            f(start, n, i, o, pairs);
        });
    });
    return are_units;
}

template <class Real>
bool eval_pairs(Arrays wi, Arrays wo, bool isotropic, int repeats, bool divide, const Tables &tables, Matrix<Real> out) {
    const size_t count = out.shape(0);
    require(int(out.shape(1)) == tables.bands, "expected room for (K, B) values");
    return over_pairs(rows_of(wi, count, 3), rows_of(wo, count, 3), count, {isotropic, repeats}, tables.needs_azimuth(),
                      [&](ptrdiff_t start, int n, const Directions &, const Directions &, const Located &pairs)
                          INLINE_LAMBDA { evaluate_tile(tables, pairs, n, divide, out.data() + start * tables.bands); });
}

void eval_located(Matrix<const double> located, const Tables &tables, Matrix<double> out) {
    require(located.shape(1) == 5 && out.shape(0) == located.shape(0) && int(out.shape(1)) == tables.bands,
            "expected located pairs (K, 5) and room for (K, B) values");
    fastest([&]() INLINE_LAMBDA {
        Located pairs;
        over_tiles(located.shape(0), [&](ptrdiff_t start, int n) INLINE_LAMBDA {
            pairs.copy(located.data() + 5 * start, n);
            evaluate_tile(tables, pairs, n, true, out.data() + start * tables.bands);
        });
    });
}

// Signed cube root of a single, within a unit in the last place; exact at zero.
//
// Holds for zero and normal numbers (1.2e-38 to 3.4e38); what is smaller gives less than 1e-12. No division: one step
// refines the reciprocal root r by a cubic in e (minimax over the guess's error, leaving 2e-6), one more refines
// x r^2 to the precision of a single.
INLINE float cube_root(float x) {
    int32_t bits, magnitude, result;
    std::memcpy(&bits, &x, 4);
    magnitude = bits & 0x7FFFFFFF;
    float a, r, y;
    std::memcpy(&a, &magnitude, 4);
    // The bits of a single are nearly its logarithm: x^(-1/3) has 1419966976 - bits / 3. The constant makes the error
    // e = 1 - x r^3 of that guess as large upwards as downwards: 0.102.
    const int32_t guess = int32_t(1419966976.0f - float(magnitude) * (1.0f / 3.0f));
    std::memcpy(&r, &guess, 4);
    float e = 1.0f - a * r * (r * r);
    r *= 0.999998016923318f + e * (0.3333284320755125f + e * (0.22373763441167005f + e * 0.1745595941927751f));
    y = a * r * r;
    e = 1.0f - y * r;
    y += y * e * (2.0f / 3.0f);
    std::memcpy(&result, &y, 4);
    result |= bits & int32_t(0x80000000);
    std::memcpy(&y, &result, 4);
    return y;
}

// Add weight times a row, or times its cube roots, to sums.
INLINE void add_row(const float *RESTRICT row, float weight, bool take_root, int n, float *RESTRICT sums) {
    if (take_root)
        for (int b = 0; b < n; ++b) sums[b] += weight * cube_root(row[b]);
    else
        for (int b = 0; b < n; ++b) sums[b] += weight * row[b];
}

// Add the sum of weights f, or of weights times cube roots of f, of K located pairs to total (K, B).
void add_located(Matrix<const double> located, const std::vector<const Tables *> &materials,
                 Vector<const float> weights, bool take_root, Matrix<float> total) {
    const int bands = int(total.shape(1));
    require(located.shape(1) == 5 && total.shape(0) == located.shape(0) && weights.size() == materials.size(),
            "expected located pairs (K, 5), a weight for each material, and totals (K, B)");
    for (const Tables *material : materials)
        require(material->bands == bands, "expected materials with the bands of the total");
    const int width = bands <= FEW ? FEW : (bands + LANES - 1) / LANES * LANES;
    std::vector<float> sums_of_tile(size_t(TILE) * width), rows_of_tile(size_t(TILE) * width);
    fastest([&]() INLINE_LAMBDA {
        Located pairs;
        float *sums = sums_of_tile.data(), *rows = rows_of_tile.data();
        over_tiles(located.shape(0), [&](ptrdiff_t start, int n) INLINE_LAMBDA {
            pairs.copy(located.data() + 5 * start, n);
            std::fill_n(sums, TILE * width, 0.0f);
            for (size_t m = 0; m < materials.size(); ++m) {
                const Tables &tables = *materials[m];
                const float weight = weights.data()[m];
                with_slices(tables.warp.phi, [&](auto count) INLINE_LAMBDA {
                    Placed<count> placed;
                    Corners<float, count> corners;
                    placed.place(tables.warp, pairs);
                    placed.weigh(tables, pairs, true, corners);
                    if (bands <= FEW) {
                        for (int k = 0; k < TILE; ++k) corners.read_few(ptrdiff_t(tables.columns) * FEW, k, rows + FEW * k);
                        add_row(rows, weight, take_root, TILE * FEW, sums);
                        return;
                    }
                    // Two rows at a time stay in the nearest cache.
                    read_tile(
                        tables, corners, pairs.cos_o, n,
                        [&](int k) INLINE_LAMBDA { return rows + ptrdiff_t(k % 2) * width; },
                        [&](int k) INLINE_LAMBDA {
                            add_row(rows + ptrdiff_t(k % 2) * width, weight, take_root, width, sums + ptrdiff_t(k) * width);
                        });
                });
            }
            for (int k = 0; k < n; ++k)
                if (pairs.cos_o[k] > 0.0)
                    add_row(sums + ptrdiff_t(k) * width, 1.0f, false, bands, total.data() + (start + k) * bands);
        });
    });
}

// Locate pairs of directions (K, 3) in the files of a symmetry: rows of `Pairs.located` into out (K, 5).
void locate_pairs(Arrays wi, Arrays wo, bool isotropic, int repeats, Matrix<double> out) {
    require(out.shape(1) == 5, "expected room for (K, 5) values");
    over_pairs(rows_of(wi, out.shape(0), 3), rows_of(wo, out.shape(0), 3), out.shape(0), {isotropic, repeats}, true,
               [&](ptrdiff_t start, int n, const Directions &, const Directions &, const Located &pairs) INLINE_LAMBDA {
                   for (int k = 0; k < n; ++k) {
                       double *to = out.data() + 5 * (start + k);
                       to[0] = pairs.theta_i[k], to[1] = pairs.phi_i[k];
                       to[2] = pairs.x[k], to[3] = pairs.y[k], to[4] = pairs.cos_o[k];
                   }
               });
}

// Densities of sampling wo from wi, K pairs, into out (K,); whether all directions are unit vectors.
bool pdf_of_pairs(Arrays wi, Arrays wo, bool isotropic, int repeats, const Tables &tables, const Warp &luminance,
                  Results<nb::ndim<1>> out) {
    const Warp &warp = tables.warp;
    const Sink sink(out);
    require(luminance.phi == warp.phi && luminance.theta == warp.theta, "expected warps of the same incident directions");
    return over_pairs(
        rows_of(wi, out.size(), 3), rows_of(wo, out.size(), 3), out.size(), {isotropic, repeats}, warp.phi.size() > 1,
        [&](ptrdiff_t start, int n, const Directions &i, const Directions &o, const Located &pairs) INLINE_LAMBDA {
            with_slices(warp.phi, [&](auto count) INLINE_LAMBDA {
                Placed<count> placed;
                placed.place(warp, pairs);
                double u[TILE], v[TILE], of_normal[TILE], of_luminance[TILE];
                warp.invert(placed.around, placed.at, u, v, of_normal);
                placed.at.find(u, v, luminance.rows, luminance.columns);
                luminance.evaluate(placed.around, placed.at, of_luminance);
                for (int k = 0; k < TILE; ++k) {
                    const double x = i.x[k] + o.x[k], y = i.y[k] + o.y[k], z = i.z[k] + o.z[k], xy = x * x + y * y;
                    const double length = std::sqrt(xy + z * z), sine = std::sqrt(xy) / length;
                    const double cos_im = (i.x[k] * x + i.y[k] * y + i.z[k] * z) / length;
                    const double pdf = of_normal[k] * of_luminance[k] / half_vector_jacobian(pairs.x[k], sine, cos_im);
                    u[k] = pairs.cos_o[k] > 0.0 ? pdf : 0.0;
                }
                for (int k = 0; k < n; ++k) sink.set(start + k, u[k]);
            });
        });
}

// Outgoing directions of wi and uniforms, K of each, into wo (K, 3), their densities into pdf (K,); whether all wi are
// unit vectors.
bool sample_directions(Arrays wi, Arrays uniforms, bool isotropic, int repeats, const Tables &tables, const Warp &luminance,
                       Results<nb::ndim<2>> wo, Results<nb::ndim<1>> pdf) {
    const Warp &warp = tables.warp;
    const Sink directions(wo), densities(pdf);
    const size_t count = pdf.size();
    const Symmetry symmetry{isotropic, repeats};
    const Rows of_wi = rows_of(wi, count, 3), of_uniforms = rows_of(uniforms, count, 2);
    require(wo.shape(0) == count && wo.shape(1) == 3, "expected room for (K, 3) directions and (K,) densities");
    require(luminance.phi == warp.phi && luminance.theta == warp.theta, "expected warps of the same incident directions");
    bool are_units = true;
    fastest([&]() INLINE_LAMBDA {
        Directions from;
        double u[TILE], v[TILE], of_luminance[TILE], of_normal[TILE];
        over_tiles(count, [&](ptrdiff_t start, int n) INLINE_LAMBDA {
            are_units &= from.load(of_wi, start, n);
            load_points(of_uniforms, start, n, v, u);
            const Incident i(from, symmetry, warp.phi.size() > 1);
            with_slices(warp.phi, [&](auto slices) INLINE_LAMBDA {
                Slices<slices> around;
                around.find(warp.phi, warp.theta, i.phi, i.theta);
                luminance.sample(around, u, v, u, v, of_luminance);
                warp.sample(around, u, v, u, v, of_normal);
            });
            const Normals m(u, v, i, symmetry);
            Directions to;
            for (int k = 0; k < TILE; ++k) {
                const double twice = 2.0 * m.cos_im[k];
                const bool is_hit = (from.z[k] > LEVEL) & (m.cos_im[k] > 0.0);
                to.x[k] = is_hit ? i.sx[k] * (twice * m.x[k] - i.w.x[k]) : 0.0;
                to.y[k] = is_hit ? i.sy[k] * (twice * m.y[k] - i.w.y[k]) : 0.0;
                to.z[k] = is_hit ? twice * m.z[k] - i.w.z[k] : 1.0;
                const double density = of_normal[k] * of_luminance[k] / half_vector_jacobian(u[k], m.sine[k], m.cos_im[k]);
                of_normal[k] = is_hit & (to.z[k] > LEVEL) ? density : 0.0;
            }
            for (int k = 0; k < n; ++k) {
                const ptrdiff_t at = 3 * (start + k);
                directions.set(at, to.x[k]), directions.set(at + 1, to.y[k]), directions.set(at + 2, to.z[k]);
                densities.set(start + k, of_normal[k]);
            }
        });
    });
    return are_units;
}

// Sums of f cos(theta_o) / pdf of the visible normals over n x n points of the unit square, of K incident directions
// (K, 3), row by row, into out (K, n, B).
void integrate(Arrays wi, bool isotropic, int repeats, const Tables &tables, Cube<double> out) {
    const Symmetry symmetry{isotropic, repeats};
    const int n = int(out.shape(1)), bands = tables.bands;
    Rows rows = rows_of(wi, out.shape(0), 3);
    const ptrdiff_t step = rows.step;
    rows.step = 0; // a tile has one incident direction
    require(int(out.shape(2)) == bands, "expected room for (K, n, B) values");
    std::fill_n(out.data(), out.size(), 0.0);
    std::vector<double> row_of_point(std::max(bands, FEW));
    fastest([&]() INLINE_LAMBDA {
        Directions from;
        double u[TILE], v[TILE], x[TILE], y[TILE], pdf[TILE], scale[TILE];
        for (size_t k = 0; k < out.shape(0); ++k) {
            from.load(rows, 0, TILE);
            rows.data = rows.is_single ? static_cast<const void *>(static_cast<const float *>(rows.data) + step)
                                       : static_cast<const void *>(static_cast<const double *>(rows.data) + step);
            if (!(from.z[0] > LEVEL)) continue;
            const Incident i(from, symmetry, true);
            with_slices(tables.warp.phi, [&](auto slices) INLINE_LAMBDA {
                Slices<slices> around;
                Corners<double, slices> corners;
                around.find(tables.warp.phi, tables.warp.theta, i.phi, i.theta);
                for (int line = 0; line < n; ++line) {
                    double *RESTRICT sums = out.data() + (k * n + line) * bands, *RESTRICT row = row_of_point.data();
                    over_tiles(n, [&](ptrdiff_t start, int points) INLINE_LAMBDA {
                        for (int j = 0; j < TILE; ++j) u[j] = (start + j + 0.5) / n, v[j] = (line + 0.5) / n;
                        tables.warp.sample(around, u, v, x, y, pdf);
                        const Normals m(x, y, i, symmetry);
                        tables.scale(i.theta, i.phi, x, y, scale);
                        for (int j = 0; j < TILE; ++j) scale[j] *= half_vector_jacobian(x[j], m.sine[j], m.cos_im[j]) / pdf[j];
                        corners.weigh(tables, around, u, v, scale);
                        for (int j = 0; j < points; ++j) {
                            const double cos_o = 2.0 * m.cos_im[j] * m.z[j] - i.w.z[j];
                            if (!(m.cos_im[j] > 0.0 && cos_o > LEVEL && pdf[j] > 0.0)) continue;
                            if (bands <= FEW)
                                corners.read_few(ptrdiff_t(tables.columns) * FEW, j, row);
                            else
                                read(Streams<double, slices>(tables, corners, j), bands, row);
                            for (int b = 0; b < bands; ++b) sums[b] += row[b];
                        }
                    });
                }
            });
        }
    });
}

enum Mode { DENSITY, SAMPLE, INVERT };

// Points (K, 2) of the unit square through a warp of parameters phi and theta (K,), into out (K, 3): two coordinates,
// unless the mode is that of the density, and the density.
void map_points(int mode, const Warp &warp, Vector<const double> phi, Vector<const double> theta, Matrix<const double> points,
                Matrix<double> out) {
    const size_t count = out.shape(0);
    require(points.shape(0) == count && phi.size() == count && theta.size() == count && out.shape(1) == 3,
            "expected points (K, 2), parameters (K,) and room for (K, 3) values");
    const Rows of_points = rows_of(Arrays(points), count, 2);
    fastest([&]() INLINE_LAMBDA {
        double x[TILE], y[TILE], to_x[TILE], to_y[TILE], pdf[TILE], phi_of_tile[TILE], theta_of_tile[TILE];
        over_tiles(count, [&](ptrdiff_t start, int n) INLINE_LAMBDA {
            load_points(of_points, start, n, x, y);
            for (int k = 0; k < TILE; ++k) {
                phi_of_tile[k] = phi.data()[start + std::min(k, n - 1)];
                theta_of_tile[k] = theta.data()[start + std::min(k, n - 1)];
            }
            with_slices(warp.phi, [&](auto slices) INLINE_LAMBDA {
                Slices<slices> around;
                around.find(warp.phi, warp.theta, phi_of_tile, theta_of_tile);
                if (mode == SAMPLE) {
                    warp.sample(around, x, y, to_x, to_y, pdf);
                    return;
                }
                Cells at;
                at.find(x, y, warp.rows, warp.columns);
                warp.invert(around, at, to_x, to_y, pdf);
            });
            for (int k = 0; k < n; ++k) {
                double *to = out.data() + 3 * (start + k);
                to[0] = to_x[k], to[1] = to_y[k], to[2] = pdf[k];
            }
        });
    });
}

// Values of an (R, C) table at points (K, 2) of the unit square, into out (K,).
void interpolate(Matrix<const double> table, Matrix<const double> points, Vector<double> out) {
    const Grid<double> grid(table);
    require(points.shape(0) == out.size(), "expected points (K, 2) and room for (K,) values");
    const Rows of_points = rows_of(Arrays(points), out.size(), 2);
    fastest([&]() INLINE_LAMBDA {
        double x[TILE], y[TILE], values[TILE];
        over_tiles(out.size(), [&](ptrdiff_t start, int n) INLINE_LAMBDA {
            load_points(of_points, start, n, x, y);
            grid.interpolate(x, y, values);
            std::copy_n(values, n, out.data() + start);
        });
    });
}

} // namespace

void bind_evaluation(nb::module_ &m) {
    nb::class_<Warp>(m, "Warp")
        .def(nb::init<Cube<const float>, Vector<const double>, Vector<const double>>(), "values"_a, "phi_nodes"_a,
             "theta_nodes"_a);
    nb::class_<Tables>(m, "Tables")
        .def(nb::init<bool, Matrix<const float>, Matrix<const float>, const Warp &, Table4<const float>>(), "jacobian"_a,
             "ndf"_a, "sigma"_a, "warp"_a, "spectra"_a, nb::keep_alive<1, 5>());
    // Arrays that receive values are never copied: a copy would receive them instead.
    m.def("eval_pairs", &eval_pairs<float>, "wi"_a, "wo"_a, "isotropic"_a, "repeats"_a, "divide"_a, "tables"_a,
          "out"_a.noconvert(), Unlocked());
    m.def("eval_pairs", &eval_pairs<double>, "wi"_a, "wo"_a, "isotropic"_a, "repeats"_a, "divide"_a, "tables"_a,
          "out"_a.noconvert(), Unlocked());
    m.def("eval_located", &eval_located, "located"_a, "tables"_a, "out"_a.noconvert(), Unlocked());
    m.def("add_located", &add_located, "located"_a, "materials"_a, "weights"_a, "take_root"_a,
          "total"_a.noconvert(), Unlocked());
    m.def("locate_pairs", &locate_pairs, "wi"_a, "wo"_a, "isotropic"_a, "repeats"_a, "out"_a.noconvert(), Unlocked());
    m.def("pdf_of_pairs", &pdf_of_pairs, "wi"_a, "wo"_a, "isotropic"_a, "repeats"_a, "tables"_a, "luminance"_a,
          "out"_a.noconvert(), Unlocked());
    m.def("sample_directions", &sample_directions, "wi"_a, "uniforms"_a, "isotropic"_a, "repeats"_a, "tables"_a,
          "luminance"_a, "wo"_a.noconvert(), "pdf"_a.noconvert(), Unlocked());
    m.def("integrate", &integrate, "wi"_a, "isotropic"_a, "repeats"_a, "tables"_a, "out"_a.noconvert(), Unlocked());
    m.def("map_points", &map_points, "mode"_a, "warp"_a, "phi"_a, "theta"_a, "points"_a, "out"_a.noconvert(), Unlocked());
    m.def("interpolate", &interpolate, "table"_a, "points"_a, "out"_a.noconvert(), Unlocked());
}
