// Measured BRDFs at pairs of directions: all bands of a pair from one inversion of a warp; sampling; weighted sums.
//
// Pairs are handled in tiles that stay in the cache: first all of a tile are located in the file's tables, in loops
// that the compiler vectorises over pairs, then their rows of bands are read, in loops vectorised over bands.

#include <nanobind/stl/vector.h>

#include <algorithm>
#include <cstring>
#include <vector>

#include "directions.hpp"
#include "kernels.hpp"
#include "warp.hpp"

using namespace nanobind::literals;

namespace {

constexpr int LANES = 8;   // values that a loop over bands handles at once
constexpr int NEAREST = 4; // corners of a cell

// The tables of a file; the arrays live as long as it does.
struct Tables {
    bool jacobian;
    Matrix<const double> ndf_array, sigma_array;
    Cube<const double> data_array, conditional_array;
    Matrix<const double> marginal_array;
    Vector<const double> phi_array, theta_array;
    Table4<const float> spectra_array;

    WarpView warp;
    const double *ndf, *sigma;
    const float *spectra; // (slice, row, column, band)
    int ndf_rows, ndf_columns, sigma_rows, sigma_columns, rows, columns, bands;

    Tables(bool jacobian, Matrix<const double> ndf_, Matrix<const double> sigma_, Cube<const double> data,
           Cube<const double> conditional, Matrix<const double> marginal, Vector<const double> phi,
           Vector<const double> theta, Table4<const float> spectra_)
        : jacobian(jacobian), ndf_array(ndf_), sigma_array(sigma_), data_array(data), conditional_array(conditional),
          marginal_array(marginal), phi_array(phi), theta_array(theta), spectra_array(spectra_) {
        warp = warp_view(data, conditional, marginal, phi, theta);
        require(spectra_.shape(0) == data.shape(0), "expected a slice for each pair of azimuth and elevation");
        require(ndf_.shape(0) >= 2 && ndf_.shape(1) >= 2 && sigma_.shape(0) >= 2 && sigma_.shape(1) >= 2 &&
                    spectra_.shape(1) >= 2 && spectra_.shape(2) >= 2,
                "expected tables of at least 2 x 2 nodes");
        ndf = ndf_.data(), sigma = sigma_.data(), spectra = spectra_.data();
        ndf_rows = int(ndf_.shape(0)), ndf_columns = int(ndf_.shape(1));
        sigma_rows = int(sigma_.shape(0)), sigma_columns = int(sigma_.shape(1));
        rows = int(spectra_.shape(1)), columns = int(spectra_.shape(2)), bands = int(spectra_.shape(3));
    }

    // Whether another material has the same grids of incident directions, half vectors, `ndf` and `sigma`.
    bool shares_grids(const Tables &other) const {
        return warp.n_phi == other.warp.n_phi && warp.n_theta == other.warp.n_theta &&
               warp.rows == other.warp.rows && warp.columns == other.warp.columns && ndf_rows == other.ndf_rows &&
               ndf_columns == other.ndf_columns && sigma_rows == other.sigma_rows &&
               sigma_columns == other.sigma_columns &&
               std::equal(warp.phi_nodes, warp.phi_nodes + warp.n_phi, other.warp.phi_nodes) &&
               std::equal(warp.theta_nodes, warp.theta_nodes + warp.n_theta, other.warp.theta_nodes);
    }

    INLINE const float *row(int slice, int i, int j) const {
        return spectra + ((ptrdiff_t(slice) * rows + i) * columns + j) * bands;
    }

    // f cos(theta_o) over the stored value at a half vector.
    INLINE double scale(Cell ndf_row, Cell ndf_column, Cell sigma_row, Cell sigma_column) const {
        if (!jacobian) return 1.0;
        return bilinear(ndf, ndf_columns, ndf_row, ndf_column) /
               (4.0 * bilinear(sigma, sigma_columns, sigma_row, sigma_column));
    }
};

// What materials with the same grids share of a tile of pairs.
struct Shared {
    Blend blend[TILE];
    Cell row[TILE], column[TILE], ndf_row[TILE], ndf_column[TILE], sigma_row[TILE], sigma_column[TILE];
};

INLINE void place(const Tables &tables, const Located &pairs, int n, Shared &shared) {
    for (int k = 0; k < n; ++k) {
        Blend &b = shared.blend[k] = tables.warp.blend(pairs.phi_i[k], pairs.theta_i[k]);
        for (int q = 0; q < 4; ++q) // a slice without weight is not read: it may hold NaN
            if (b.weight[q] == 0.0) b.slice[q] = b.slice[q ^ 1];
        shared.row[k] = cell(pairs.y[k], tables.warp.rows);
        shared.column[k] = cell(pairs.x[k], tables.warp.columns);
        shared.ndf_row[k] = cell(pairs.y[k], tables.ndf_rows);
        shared.ndf_column[k] = cell(pairs.x[k], tables.ndf_columns);
        shared.sigma_row[k] = cell(phi_to_u(pairs.phi_i[k]), tables.sigma_rows);
        shared.sigma_column[k] = cell(theta_to_u(pairs.theta_i[k]), tables.sigma_columns);
    }
}

// Cells of one material's spectra, and the weights of their corners in each slice, for a tile of pairs.
template <class Real> struct Corners {
    int i[TILE], j[TILE];
    Real weight[TILE][4][NEAREST];
};

template <class Real>
INLINE void weigh(const Tables &tables, const Located &pairs, const Shared &shared, int n, bool divide,
                  Corners<Real> &corners) {
    for (int k = 0; k < n; ++k) {
        if (pairs.cos_o[k] <= 0.0) continue;
        const Blend &b = shared.blend[k];
        double u, v, pdf;
        tables.warp.invert(b, shared.row[k], shared.column[k], u, v, pdf);
        double scale = tables.scale(shared.ndf_row[k], shared.ndf_column[k], shared.sigma_row[k], shared.sigma_column[k]);
        if (divide) scale /= pairs.cos_o[k];
        const Cell row = cell(v, tables.rows), column = cell(u, tables.columns);
        corners.i[k] = row.index, corners.j[k] = column.index;
        const double low = (1.0 - row.offset) * scale, high = row.offset * scale;
        for (int q = 0; q < 4; ++q) {
            corners.weight[k][q][0] = Real(b.weight[q] * (low * (1.0 - column.offset)));
            corners.weight[k][q][1] = Real(b.weight[q] * (low * column.offset));
            corners.weight[k][q][2] = Real(b.weight[q] * (high * (1.0 - column.offset)));
            corners.weight[k][q][3] = Real(b.weight[q] * (high * column.offset));
        }
    }
}

template <class Real, int N> struct Streams {
    const float *p[N];
    Real w[N];

    INLINE Real at(int b) const {
        Real sum = 0;
        for (int s = 0; s < N; s += 4)
            sum += (w[s] * p[s][b] + w[s + 1] * p[s + 1][b]) + (w[s + 2] * p[s + 2][b] + w[s + 3] * p[s + 3][b]);
        return sum;
    }
};

template <class Real, int N>
INLINE Streams<Real, N> streams(const Tables &t, const Blend &b, const Corners<Real> &corners, int k) {
    Streams<Real, N> out;
    for (int q = 0; q < N / 4; ++q) {
        const float *low = t.row(b.slice[q], corners.i[k], corners.j[k]), *high = low + ptrdiff_t(t.columns) * t.bands;
        out.p[4 * q] = low, out.p[4 * q + 1] = low + t.bands;
        out.p[4 * q + 2] = high, out.p[4 * q + 3] = high + t.bands;
        for (int c = 0; c < 4; ++c) out.w[4 * q + c] = corners.weight[k][q][c];
    }
    return out;
}

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

template <class Real>
INLINE void read_two(const Streams<Real, 8> &s, const Streams<Real, 8> &next, int n, Real *RESTRICT row,
                     Real *RESTRICT next_row) {
    const Streams<Real, 8> local = s;
    Streams<Real, 8> other = next;
    for (int q = 0; q < 8; ++q) other.p[q] = local.p[q];
    over_bands(n, [&](int b) INLINE_LAMBDA {
        const Real first = local.at(b), second = other.at(b);
        row[b] = first;
        next_row[b] = second;
    });
}

// Rows of bands of a tile: `row_of(k)` is where those of pair k go, and `done(k)` is called when they are there.
template <class Real, class RowOf, class Done>
INLINE void read_tile(const Tables &tables, const Located &pairs, const Shared &shared, const Corners<Real> &corners,
                      int n, const RowOf &row_of, const Done &done) {
    for (int k = 0; k < n;) {
        if (pairs.cos_o[k] <= 0.0) {
            ++k;
            continue;
        }
        const Blend &b = shared.blend[k];
        const int m = k + 1;
        if (m < n && pairs.cos_o[m] > 0.0) {
            const Blend &c = shared.blend[m];
            const bool is_same = corners.i[m] == corners.i[k] && corners.j[m] == corners.j[k] &&
                                 c.slice[0] == b.slice[0] && c.slice[1] == b.slice[1];
            if (is_same && !b.has_two_azimuths && !c.has_two_azimuths) {
                read_two(streams<Real, 8>(tables, b, corners, k), streams<Real, 8>(tables, c, corners, m),
                         tables.bands, row_of(k), row_of(m));
                done(k);
                done(m);
                k += 2;
                continue;
            }
            if (!is_same) {
                const Streams<Real, 8> ahead = streams<Real, 8>(tables, c, corners, m);
                for (int q = 0; q < 8; ++q) prefetch(ahead.p[q]), prefetch(ahead.p[q] + 16);
            }
        }
        if (b.has_two_azimuths)
            read(streams<Real, 16>(tables, b, corners, k), tables.bands, row_of(k));
        else
            read(streams<Real, 8>(tables, b, corners, k), tables.bands, row_of(k));
        done(k);
        ++k;
    }
}

INLINE int copy_located(const double *located, ptrdiff_t start, ptrdiff_t count, Located &pairs) {
    const int n = int(std::min<ptrdiff_t>(TILE, count - start));
    for (int k = 0; k < n; ++k) {
        const double *from = located + 5 * (start + k);
        pairs.theta_i[k] = from[0], pairs.phi_i[k] = from[1];
        pairs.x[k] = from[2], pairs.y[k] = from[3], pairs.cos_o[k] = from[4];
    }
    return n;
}

// All bands of a tile of located pairs into out (n, B).
template <class Real> INLINE void evaluate_tile(const Tables &tables, const Located &pairs, int n, bool divide, Real *out) {
    Shared shared;
    Corners<Real> corners;
    place(tables, pairs, n, shared);
    weigh(tables, pairs, shared, n, divide, corners);
    for (int k = 0; k < n; ++k)
        if (pairs.cos_o[k] <= 0.0) std::fill_n(out + ptrdiff_t(k) * tables.bands, tables.bands, Real(0));
    read_tile(
        tables, pairs, shared, corners, n,
        [&](int k) INLINE_LAMBDA { return out + ptrdiff_t(k) * tables.bands; }, [](int) INLINE_LAMBDA {});
}

// Evaluate all pairs, tile by tile: those in `located` (K, 5) or, without it, of wi and wo (K, 3).
template <class Real>
void evaluate(const double *located, const double *wi, const double *wo, ptrdiff_t count, bool isotropic, int reduction,
              bool divide, const Tables &tables, Real *out) {
    fastest([&]() INLINE_LAMBDA {
        Located pairs;
        for (ptrdiff_t start = 0; start < count; start += TILE) {
            const int n = int(std::min<ptrdiff_t>(TILE, count - start));
            if (located)
                copy_located(located, start, count, pairs);
            else
                locate(wi + 3 * start, wo + 3 * start, n, isotropic, reduction, pairs);
            evaluate_tile(tables, pairs, n, divide, out + start * tables.bands);
        }
    });
}

template <class Real>
void eval_pairs(Matrix<const double> wi, Matrix<const double> wo, bool isotropic, int reduction, bool divide,
                const Tables &tables, Matrix<Real> out) {
    require(wi.shape(1) == 3 && wo.shape(1) == 3 && wo.shape(0) == wi.shape(0) && out.shape(0) == wi.shape(0) &&
                int(out.shape(1)) == tables.bands,
            "expected directions (K, 3) and room for (K, B) values");
    evaluate<Real>(nullptr, wi.data(), wo.data(), ptrdiff_t(wi.shape(0)), isotropic, reduction, divide, tables, out.data());
}

template <class Real>
void eval_located(Matrix<const double> located, bool divide, const Tables &tables, Matrix<Real> out) {
    require(located.shape(1) == 5 && out.shape(0) == located.shape(0) && int(out.shape(1)) == tables.bands,
            "expected located pairs (K, 5) and room for (K, B) values");
    evaluate<Real>(located.data(), nullptr, nullptr, ptrdiff_t(located.shape(0)), false, 1, divide, tables, out.data());
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

void cube_roots(Vector<const float> values, Vector<float> out) {
    require(values.size() == out.size(), "expected arrays of the same size");
    const int n = int(values.size());
    std::fill_n(out.data(), n, 0.0f);
    fastest([&]() INLINE_LAMBDA { add_row(values.data(), 1.0f, true, n, out.data()); });
}

// Add the sum of weights f, or of weights times cube roots of f, of K located pairs to total (K, B).
void add_located(Matrix<const double> located, const std::vector<const Tables *> &materials,
                 Vector<const float> weights, bool take_root, Matrix<float> total) {
    const ptrdiff_t count = ptrdiff_t(located.shape(0));
    const int bands = int(total.shape(1)), width = (bands + LANES - 1) / LANES * LANES;
    require(located.shape(1) == 5 && total.shape(0) == located.shape(0) && weights.size() == materials.size(),
            "expected located pairs (K, 5), a weight for each material, and totals (K, B)");
    std::vector<bool> is_placed(materials.size());
    for (size_t m = 0; m < materials.size(); ++m) {
        require(materials[m]->bands == bands, "expected materials with the bands of the total");
        is_placed[m] = m > 0 && materials[m]->shares_grids(*materials[m - 1]);
    }
    std::vector<float> sums_of_tile(size_t(TILE) * width), two_rows(size_t(2) * width);
    fastest([&]() INLINE_LAMBDA {
        Located pairs;
        Shared shared;
        Corners<float> corners;
        float *sums = sums_of_tile.data(), *rows = two_rows.data();
        for (ptrdiff_t start = 0; start < count; start += TILE) {
            const int n = copy_located(located.data(), start, count, pairs);
            std::fill(sums, sums + size_t(TILE) * width, 0.0f);
            for (size_t m = 0; m < materials.size(); ++m) {
                const Tables &tables = *materials[m];
                const float weight = weights.data()[m];
                if (!is_placed[m]) place(tables, pairs, n, shared);
                weigh(tables, pairs, shared, n, true, corners);
                read_tile(
                    tables, pairs, shared, corners, n,
                    [&](int k) INLINE_LAMBDA { return rows + ptrdiff_t(k % 2) * width; },
                    [&](int k) INLINE_LAMBDA {
                        add_row(rows + ptrdiff_t(k % 2) * width, weight, take_root, width, sums + ptrdiff_t(k) * width);
                    });
            }
            for (int k = 0; k < n; ++k)
                add_row(sums + ptrdiff_t(k) * width, 1.0f, false, bands, total.data() + (start + k) * bands);
        }
    });
}

// Locate pairs of directions (K, 3) in the files of a symmetry: rows of `Pairs.located` into out (K, 5).
void locate_pairs(Matrix<const double> wi, Matrix<const double> wo, bool isotropic, int reduction, Matrix<double> out) {
    const ptrdiff_t count = ptrdiff_t(wi.shape(0));
    require(wi.shape(1) == 3 && wo.shape(1) == 3 && wo.shape(0) == wi.shape(0) && out.shape(0) == wi.shape(0) &&
                out.shape(1) == 5,
            "expected directions (K, 3) and room for (K, 5) values");
    fastest([&]() INLINE_LAMBDA {
        Located pairs;
        for (ptrdiff_t start = 0; start < count; start += TILE) {
            const int n = int(std::min<ptrdiff_t>(TILE, count - start));
            locate(wi.data() + 3 * start, wo.data() + 3 * start, n, isotropic, reduction, pairs);
            for (int k = 0; k < n; ++k) {
                double *to = out.data() + 5 * (start + k);
                to[0] = pairs.theta_i[k], to[1] = pairs.phi_i[k];
                to[2] = pairs.x[k], to[3] = pairs.y[k], to[4] = pairs.cos_o[k];
            }
        }
    });
}

// Densities of sampling wo from wi, K pairs (K, 3), into out (K,); `luminance` are nodes of the sampled density.
void pdf_of_pairs(Matrix<const double> wi, Matrix<const double> wo, bool isotropic, int reduction, const Tables &tables,
                  Cube<const double> luminance, Vector<double> out) {
    const ptrdiff_t count = ptrdiff_t(wi.shape(0));
    require(wi.shape(1) == 3 && wo.shape(1) == 3 && wo.shape(0) == wi.shape(0) && out.size() == wi.shape(0),
            "expected directions (K, 3) and room for (K,) densities");
    require(luminance.shape(0) == tables.data_array.shape(0) && luminance.shape(1) >= 2 && luminance.shape(2) >= 2,
            "expected a luminance for each slice, of at least 2 x 2 nodes");
    WarpView sampled = tables.warp;
    sampled.data = luminance.data(), sampled.conditional = sampled.marginal = nullptr;
    sampled.rows = int(luminance.shape(1)), sampled.columns = int(luminance.shape(2));
    fastest([&]() INLINE_LAMBDA {
        Located pairs;
        for (ptrdiff_t start = 0; start < count; start += TILE) {
            const int n = int(std::min<ptrdiff_t>(TILE, count - start));
            locate(wi.data() + 3 * start, wo.data() + 3 * start, n, isotropic, reduction, pairs);
            for (int k = 0; k < n; ++k) {
                out.data()[start + k] = 0.0;
                if (pairs.cos_o[k] <= 0.0) continue;
                const Blend b = tables.warp.blend(pairs.phi_i[k], pairs.theta_i[k]);
                double u, v, pdf;
                tables.warp.invert(b, cell(pairs.y[k], tables.warp.rows), cell(pairs.x[k], tables.warp.columns), u, v, pdf);
                // 2 <wi, m> = |wi + wo|
                const double *i = wi.data() + 3 * (start + k), *o = wo.data() + 3 * (start + k);
                const double mx = i[0] + o[0], my = i[1] + o[1], mz = i[2] + o[2];
                const double length = std::sqrt(mx * mx + my * my + mz * mz);
                const double cos_im = (i[0] * mx + i[1] * my + i[2] * mz) / length;
                const double theta_m = elevation(mx, my, mz);
                out.data()[start + k] =
                    pdf * sampled.density(b, u, v) / half_vector_jacobian(pairs.x[k], theta_m, cos_im);
            }
        }
    });
}

// Outgoing directions of wi (K, 3) and uniforms (K, 2) into wo (K, 3), their densities into pdf (K,).
void sample_directions(Matrix<const double> wi, Matrix<const double> uniforms, bool isotropic, int reduction,
                       const Tables &tables, Cube<const double> luminance, Cube<const double> conditional,
                       Matrix<const double> marginal, Matrix<double> wo, Vector<double> pdf) {
    const ptrdiff_t count = ptrdiff_t(wi.shape(0));
    require(wi.shape(1) == 3 && uniforms.shape(0) == wi.shape(0) && uniforms.shape(1) == 2 &&
                wo.shape(0) == wi.shape(0) && wo.shape(1) == 3 && pdf.size() == wi.shape(0),
            "expected directions (K, 3), uniforms (K, 2), and room for (K, 3) directions and (K,) densities");
    const WarpView sampled = warp_view(luminance, conditional, marginal, tables.phi_array, tables.theta_array);
    fastest([&]() INLINE_LAMBDA {
        for (ptrdiff_t k = 0; k < count; ++k) {
            double *to = wo.data() + 3 * k;
            pdf.data()[k] = to[0] = to[1] = 0.0, to[2] = 1.0;
            const double *from = wi.data() + 3 * k, *uniform = uniforms.data() + 2 * k;
            if (!(from[2] > 0.0)) continue;
            const Incident w(from, reduction);
            const Blend b = tables.warp.blend(w.phi, w.theta);
            double x, y, of_luminance, ux, uy, of_normal;
            sampled.sample(b, uniform[1], uniform[0], x, y, of_luminance);
            tables.warp.sample(b, x, y, ux, uy, of_normal);
            const HalfVector m(ux, uy, w.phi, isotropic);
            const double cos_im = m.dot(w);
            if (!(cos_im > 0.0)) continue;
            to[0] = w.sx * (2.0 * cos_im * m.x - w.x);
            to[1] = w.sy * (2.0 * cos_im * m.y - w.y);
            to[2] = 2.0 * cos_im * m.z - w.z;
            if (to[2] > 0.0) pdf.data()[k] = of_normal * of_luminance / half_vector_jacobian(ux, m.theta, cos_im);
        }
    });
}

// Sums of f cos(theta_o) / pdf of the visible normals over n x n points of the unit square, of K incident directions
// (K, 3), row by row, into out (K, n, B).
void integrate(Matrix<const double> wi, bool isotropic, int reduction, const Tables &tables, Cube<double> out) {
    const ptrdiff_t count = ptrdiff_t(wi.shape(0));
    const int n = int(out.shape(1)), bands = tables.bands;
    require(wi.shape(1) == 3 && out.shape(0) == wi.shape(0) && int(out.shape(2)) == bands,
            "expected directions (K, 3) and room for (K, n, B) values");
    std::vector<double> row_of_point(bands);
    fastest([&]() INLINE_LAMBDA {
        double *RESTRICT row = row_of_point.data();
        std::fill_n(out.data(), count * n * bands, 0.0);
        for (ptrdiff_t k = 0; k < count; ++k) {
            const double *from = wi.data() + 3 * k;
            if (!(from[2] > 0.0)) continue;
            const Incident w(from, reduction);
            Blend b = tables.warp.blend(w.phi, w.theta);
            const Blend whole = b;
            for (int q = 0; q < 4; ++q)
                if (b.weight[q] == 0.0) b.slice[q] = b.slice[q ^ 1];
            const Cell sigma_row = cell(phi_to_u(w.phi), tables.sigma_rows);
            const Cell sigma_column = cell(theta_to_u(w.theta), tables.sigma_columns);
            for (int i = 0; i < n; ++i) {
                double *RESTRICT sums = out.data() + (k * n + i) * bands;
                for (int j = 0; j < n; ++j) {
                    const double u = (j + 0.5) / n, v = (i + 0.5) / n;
                    double ux, uy, pdf;
                    tables.warp.sample(whole, u, v, ux, uy, pdf);
                    const HalfVector m(ux, uy, w.phi, isotropic);
                    const double cos_im = m.dot(w), cos_o = 2.0 * cos_im * m.z - w.z;
                    if (!(cos_im > 0.0 && cos_o > 0.0 && pdf > 0.0)) continue;
                    const double scale = tables.scale(cell(uy, tables.ndf_rows), cell(ux, tables.ndf_columns), sigma_row,
                                                      sigma_column) *
                                         half_vector_jacobian(ux, m.theta, cos_im) / pdf;
                    const Cell across = cell(v, tables.rows), along = cell(u, tables.columns);
                    Corners<double> corners;
                    corners.i[0] = across.index, corners.j[0] = along.index;
                    for (int q = 0; q < 4; ++q) {
                        const double share = b.weight[q] * scale, ty = across.offset, tx = along.offset;
                        corners.weight[0][q][0] = share * ((1 - ty) * (1 - tx));
                        corners.weight[0][q][1] = share * ((1 - ty) * tx);
                        corners.weight[0][q][2] = share * (ty * (1 - tx));
                        corners.weight[0][q][3] = share * (ty * tx);
                    }
                    if (b.has_two_azimuths)
                        read(streams<double, 16>(tables, b, corners, 0), bands, row);
                    else
                        read(streams<double, 8>(tables, b, corners, 0), bands, row);
                    for (int band = 0; band < bands; ++band) sums[band] += row[band];
                }
            }
        }
    });
}

enum Mode { DENSITY, SAMPLE, INVERT };

// Points (K, 2) of the unit square through the warp of parameters phi and theta (K,), into out (K, 3): two coordinates,
// unless the mode is that of the density, and the density.
void map_points(int mode, Cube<const double> data, Cube<const double> conditional, Matrix<const double> marginal,
                Vector<const double> phi_nodes, Vector<const double> theta_nodes, Vector<const double> phi,
                Vector<const double> theta, Matrix<const double> points, Matrix<double> out) {
    const ptrdiff_t count = ptrdiff_t(points.shape(0));
    require(points.shape(1) == 2 && phi.size() == points.shape(0) && theta.size() == points.shape(0) &&
                out.shape(0) == points.shape(0) && out.shape(1) == 3,
            "expected points (K, 2), parameters (K,) and room for (K, 3) values");
    const WarpView warp = warp_view(data, conditional, marginal, phi_nodes, theta_nodes);
    fastest([&]() INLINE_LAMBDA {
        for (ptrdiff_t k = 0; k < count; ++k) {
            const double x = points.data()[2 * k], y = points.data()[2 * k + 1];
            double *to = out.data() + 3 * k;
            const Blend b = warp.blend(phi.data()[k], theta.data()[k]);
            if (mode == DENSITY)
                to[2] = warp.density(b, x, y);
            else if (mode == SAMPLE)
                warp.sample(b, x, y, to[0], to[1], to[2]);
            else
                warp.invert(b, cell(y, warp.rows), cell(x, warp.columns), to[0], to[1], to[2]);
        }
    });
}

// Values of an (R, C) table at points (K, 2) of the unit square, into out (K,).
void interpolate(Matrix<const double> table, Matrix<const double> points, Vector<double> out) {
    require(table.shape(0) >= 2 && table.shape(1) >= 2 && points.shape(1) == 2 && out.size() == points.shape(0),
            "expected a table of at least 2 x 2 nodes, points (K, 2) and room for (K,) values");
    const int rows = int(table.shape(0)), columns = int(table.shape(1));
    for (size_t k = 0; k < out.size(); ++k) {
        const double *point = points.data() + 2 * k;
        out.data()[k] = bilinear(table.data(), columns, cell(point[1], rows), cell(point[0], columns));
    }
}

} // namespace

void bind_evaluation(nb::module_ &m) {
    nb::class_<Tables>(m, "Tables")
        .def(nb::init<bool, Matrix<const double>, Matrix<const double>, Cube<const double>, Cube<const double>,
                      Matrix<const double>, Vector<const double>, Vector<const double>, Table4<const float>>(),
             "jacobian"_a, "ndf"_a, "sigma"_a, "data"_a, "conditional"_a, "marginal"_a, "phi_nodes"_a, "theta_nodes"_a,
             "spectra"_a);
    // Arrays that receive values are never copied: a copy would receive them instead.
    m.def("eval_pairs", &eval_pairs<float>, "wi"_a, "wo"_a, "isotropic"_a, "reduction"_a, "divide"_a, "tables"_a,
          "out"_a.noconvert(), Unlocked());
    m.def("eval_pairs", &eval_pairs<double>, "wi"_a, "wo"_a, "isotropic"_a, "reduction"_a, "divide"_a, "tables"_a,
          "out"_a.noconvert(), Unlocked());
    m.def("eval_located", &eval_located<float>, "located"_a, "divide"_a, "tables"_a, "out"_a.noconvert(), Unlocked());
    m.def("eval_located", &eval_located<double>, "located"_a, "divide"_a, "tables"_a, "out"_a.noconvert(), Unlocked());
    m.def("cube_roots", &cube_roots, "values"_a, "out"_a.noconvert(), Unlocked());
    m.def("add_located", &add_located, "located"_a, "materials"_a, "weights"_a, "take_root"_a,
          "total"_a.noconvert(), Unlocked());
    m.def("locate_pairs", &locate_pairs, "wi"_a, "wo"_a, "isotropic"_a, "reduction"_a, "out"_a.noconvert(), Unlocked());
    m.def("pdf_of_pairs", &pdf_of_pairs, "wi"_a, "wo"_a, "isotropic"_a, "reduction"_a, "tables"_a, "luminance"_a,
          "out"_a.noconvert(), Unlocked());
    m.def("sample_directions", &sample_directions, "wi"_a, "uniforms"_a, "isotropic"_a, "reduction"_a, "tables"_a,
          "luminance"_a, "conditional"_a, "marginal"_a, "wo"_a.noconvert(), "pdf"_a.noconvert(), Unlocked());
    m.def("integrate", &integrate, "wi"_a, "isotropic"_a, "reduction"_a, "tables"_a, "out"_a.noconvert(), Unlocked());
    m.def("map_points", &map_points, "mode"_a, "data"_a, "conditional"_a, "marginal"_a, "phi_nodes"_a,
          "theta_nodes"_a, "phi"_a, "theta"_a, "points"_a, "out"_a.noconvert(), Unlocked());
    m.def("interpolate", &interpolate, "table"_a, "points"_a, "out"_a.noconvert(), Unlocked());
}
