// Loops over normals, profiles, files' values and interfaces: the virtual goniometer, plausibility, compact materials,
// GGX and Fresnel.

#include <algorithm>
#include <complex>
#include <vector>

#include "common.hpp"
#include "kernels.hpp"

using namespace nanobind::literals;

namespace {

// Areas (M,) of facets with normals m (3, M) as seen from w (N, 3), summed, into out (N,).
void project_facets(Matrix<const double> w, Matrix<const double> m, Vector<const double> area, Vector<double> out) {
    const size_t count = area.size();
    require(w.shape(1) == 3 && m.shape(0) == 3 && m.shape(1) == count && out.size() == w.shape(0),
            "expected directions (N, 3), normals (3, M), areas (M,) and room for (N,) sums");
    fastest([&]() INLINE_LAMBDA {
        constexpr size_t lanes = 8; // partial sums, in vectors
        const double *RESTRICT mx = m.data(), *RESTRICT my = mx + count, *RESTRICT mz = my + count;
        const double *RESTRICT a = area.data();
        for (size_t i = 0; i < out.size(); ++i) {
            const double x = w.data()[3 * i], y = w.data()[3 * i + 1], z = w.data()[3 * i + 2];
            double sums[lanes] = {};
            size_t k = 0;
            for (; k + lanes <= count; k += lanes)
                for (size_t lane = 0; lane < lanes; ++lane) {
                    const double cosine = x * mx[k + lane] + y * my[k + lane] + z * mz[k + lane];
                    sums[lane] += (cosine > 0.0 ? cosine : 0.0) * a[k + lane];
                }
            double total = 0.0;
            for (; k < count; ++k) {
                const double cosine = x * mx[k] + y * my[k] + z * mz[k];
                total += (cosine > 0.0 ? cosine : 0.0) * a[k];
            }
            for (const double sum : sums) total += sum;
            out.data()[i] = total;
        }
    });
}

// Measured values, shifted by their differences to the next and the previous ones times weights (axis, node), by at most
// a fifth of the value.
void add_shift(Table5<const float> spectra, Table4<const bool> measured, Matrix<const float> ahead,
               Matrix<const float> behind, Table5<float> out) {
    ptrdiff_t n[4], stride[4];
    const ptrdiff_t B = ptrdiff_t(spectra.shape(4));
    for (int axis = 3; axis >= 0; --axis) {
        n[axis] = ptrdiff_t(spectra.shape(axis));
        stride[axis] = axis == 3 ? B : stride[axis + 1] * n[axis + 1];
        require(measured.shape(axis) == spectra.shape(axis) && out.shape(axis) == spectra.shape(axis) &&
                    ahead.shape(1) >= spectra.shape(axis),
                "expected values and room (P, T, H, W, B), measured (P, T, H, W), and weights (4, n)");
    }
    require(out.shape(4) == spectra.shape(4) && ahead.shape(0) == 4 && behind.shape(0) == 4 &&
                behind.shape(1) == ahead.shape(1),
            "expected weights (4, n)");
    fastest([&]() INLINE_LAMBDA {
        const ptrdiff_t nodes = n[0] * n[1] * n[2] * n[3];
        for (ptrdiff_t node = 0; node < nodes; ++node) {
            if (!measured.data()[node]) continue;
            const float *RESTRICT here = spectra.data() + node * B, *next[4], *last[4];
            float *RESTRICT to = out.data() + node * B;
            float forward[4], backward[4];
            ptrdiff_t rest = node;
            for (int axis = 3; axis >= 0; --axis) {
                const ptrdiff_t k = rest % n[axis];
                rest /= n[axis];
                next[axis] = k + 1 < n[axis] ? here + stride[axis] : here;
                last[axis] = k > 0 ? here - stride[axis] : here;
                forward[axis] = ahead.data()[axis * ptrdiff_t(ahead.shape(1)) + k];
                backward[axis] = behind.data()[axis * ptrdiff_t(ahead.shape(1)) + k];
            }
            for (ptrdiff_t b = 0; b < B; ++b) {
                const float f = here[b], limit = 0.2f * f;
                float shift = 0.0f;
                for (int axis = 0; axis < 4; ++axis)
                    shift += forward[axis] * (next[axis][b] - f) - backward[axis] * (f - last[axis][b]);
                to[b] = f + std::min(std::max(shift, -limit), limit);
            }
        }
    });
}

// The larger of two values; NaN where one is.
INLINE double maximum(double a, double b) { return a >= b || a != a ? a : b; }

// Depth of the deepest minimum of a profile (D,); `left` has room for D values.
INLINE double deepest(const double *f, ptrdiff_t D, double dark, double *left) {
    double highest = f[0], depth = 0.0;
    for (ptrdiff_t d = 0; d < D; ++d) left[d] = highest = maximum(highest, f[d]);
    highest = f[D - 1];
    for (ptrdiff_t d = D - 1; d >= 0; --d) {
        highest = maximum(highest, f[d]);
        const double side = left[d] < highest ? left[d] : highest;
        depth = maximum(depth, (side - f[d]) / (side > dark ? side : dark));
    }
    return depth;
}

void valley_depths(Matrix<const double> f, double dark, Vector<double> depth) {
    const ptrdiff_t D = ptrdiff_t(f.shape(1));
    require(depth.size() == f.shape(0) && D >= 1, "expected profiles (K, D) and room for (K,) depths");
    std::vector<double> left(D);
    for (size_t k = 0; k < depth.size(); ++k) depth.data()[k] = deepest(f.data() + k * D, D, dark, left.data());
}

// Cubes of sums of multiples of basis spectra (K, B), into values (S, H, W, B). Coefficients are multiples as differences
// along rows and columns, (K, S, H, W); `least` is that of the sums.
void dequantise(Table4<const int32_t> coefficients, Matrix<const float> basis, float least, Table4<float> values) {
    const size_t K = basis.shape(0), S = values.shape(0), H = values.shape(1), W = values.shape(2), B = values.shape(3);
    require(coefficients.shape(0) == K && coefficients.shape(1) == S && coefficients.shape(2) == H &&
                coefficients.shape(3) == W && basis.shape(1) == B,
            "expected coefficients (K, S, H, W), a basis (K, B) and room for (S, H, W, B) values");
    std::vector<uint32_t> multiples(W * K); // unsigned: sums of changed files wrap around
    fastest([&]() INLINE_LAMBDA {
        for (size_t s = 0; s < S; ++s) {
            std::fill(multiples.begin(), multiples.end(), 0u);
            for (size_t i = 0; i < H; ++i) {
                for (size_t k = 0; k < K; ++k) {
                    uint32_t left = 0;
                    const int32_t *from = coefficients.data() + ((k * S + s) * H + i) * W;
                    for (size_t j = 0; j < W; ++j) {
                        left += uint32_t(from[j]);
                        multiples[j * K + k] += left;
                    }
                }
                for (size_t j = 0; j < W; ++j) {
                    float *RESTRICT to = values.data() + ((s * H + i) * W + j) * B;
                    std::fill_n(to, B, 0.0f);
                    for (size_t k = 0; k < K; ++k) {
                        const float multiple = float(int32_t(multiples[j * K + k]));
                        if (multiple == 0.0f) continue;
                        const float *RESTRICT component = basis.data() + k * B;
                        for (size_t b = 0; b < B; ++b) to[b] += multiple * component[b];
                    }
                    for (size_t b = 0; b < B; ++b) {
                        const float root = to[b] > least ? to[b] : least;
                        to[b] = root * root * root;
                    }
                }
            }
        }
    });
}

// Moments of G2 / G1 over visible normals, for stretched directions (n, 3), into out (n, n_cosines); the cap has heights
// and their weights (A,), and azimuths (C,).
void integrate_caps(Matrix<const double> stretched, double alpha_x, double alpha_y, Vector<const double> heights,
                    Vector<const double> weights, Vector<const double> cos_phi, Vector<const double> sin_phi,
                    Matrix<double> out) {
    const ptrdiff_t n = ptrdiff_t(stretched.shape(0)), A = ptrdiff_t(heights.size()), C = ptrdiff_t(cos_phi.size());
    const int n_cosines = int(out.shape(1));
    require(stretched.shape(1) == 3 && out.shape(0) == stretched.shape(0) && weights.size() == heights.size() &&
                sin_phi.size() == cos_phi.size() && n_cosines >= 2,
            "expected directions (n, 3), heights and weights (A,), azimuths (C,) and room for (n, n_cosines) moments");
    fastest([&]() INLINE_LAMBDA {
        std::fill_n(out.data(), n * n_cosines, 0.0);
        for (ptrdiff_t i = 0; i < n; ++i) {
            const double wx = stretched.data()[3 * i], wy = stretched.data()[3 * i + 1], zi = stretched.data()[3 * i + 2];
            double *RESTRICT moments = out.data() + i * n_cosines;
            // The direction itself: M w', normalised.
            double ix = wx / alpha_x, iy = wy / alpha_y;
            const double length = std::sqrt(ix * ix + iy * iy + zi * zi), iz = zi / length;
            ix /= length, iy /= length;
            for (ptrdiff_t a = 0; a < A; ++a) {
                const double cz = (1.0 - heights.data()[a]) * (1.0 + zi) - zi;
                const double cr = std::sqrt(std::max(1.0 - cz * cz, 0.0));
                for (ptrdiff_t c = 0; c < C; ++c) {
                    // M^-T h with M = diag(1 / alpha)
                    const double hx = (cr * cos_phi.data()[c] + wx) * alpha_x;
                    const double hy = (cr * sin_phi.data()[c] + wy) * alpha_y, hz = cz + zi;
                    const double h = std::sqrt(hx * hx + hy * hy + hz * hz);
                    if (h == 0.0) continue;
                    const double cosine = (ix * hx + iy * hy + iz * hz) / h, oz = 2.0 * cosine * hz / h - iz;
                    if (!(oz > 0.0)) continue;
                    const double ox = alpha_x * (2.0 * cosine * hx / h - ix), oy = alpha_y * (2.0 * cosine * hy / h - iy);
                    const double zo = oz / std::sqrt(ox * ox + oy * oy + oz * oz);
                    const double value = zo * (1.0 + zi) / (zi + zo) * weights.data()[a] / C; // G2 / G1(wi)
                    const double position = (cosine > 0.0 ? std::min(cosine, 1.0) : 0.0) * (n_cosines - 1);
                    const int k = std::min(int(position), n_cosines - 2);
                    moments[k] += value * (k + 1 - position);
                    moments[k + 1] += value * (position - k);
                }
            }
        }
    });
}

INLINE double cosine_of(double c) { return c > 0.0 ? std::min(c, 1.0) : 0.0; }

// Fresnel reflectance of conductors at cosines (n,), for indices (B,), into two arrays (n, B).
void reflect_conductor(Vector<const double> cos_theta, Vector<const double> eta, Vector<const double> k,
                       Matrix<double> parallel, Matrix<double> perpendicular) {
    const size_t n = cos_theta.size(), B = eta.size();
    require(k.size() == B && parallel.shape(0) == n && parallel.shape(1) == B && perpendicular.shape(0) == n &&
                perpendicular.shape(1) == B,
            "expected cosines (n,), indices (B,) and room for (n, B) values");
    fastest([&]() INLINE_LAMBDA {
        const double *RESTRICT etas = eta.data(), *RESTRICT ks = k.data();
        for (size_t i = 0; i < n; ++i) {
            const double c = cosine_of(cos_theta.data()[i]), c2 = c * c, s2 = 1.0 - c2;
            double *RESTRICT p = parallel.data() + i * B, *RESTRICT s = perpendicular.data() + i * B;
            for (size_t b = 0; b < B; ++b) {
                const double t0 = etas[b] * etas[b] - ks[b] * ks[b] - s2, product = 2.0 * etas[b] * ks[b];
                const double a2b2 = std::sqrt(t0 * t0 + product * product), t1 = a2b2 + c2;
                const double inside = 0.5 * (a2b2 + t0), t2 = 2.0 * c * std::sqrt(inside > 0.0 ? inside : 0.0);
                const double t3 = c2 * a2b2 + s2 * s2, t4 = t2 * s2;
                const bool is_absent = t1 + t2 == 0.0; // index 1 at grazing: the limit is an interface that is not there
                const double rs = is_absent ? 1.0 : (t1 - t2) / (is_absent ? 1.0 : t1 + t2);
                s[b] = rs;
                p[b] = !is_absent && t3 + t4 > 0.0 ? rs * (t3 - t4) / (t3 + t4) : rs;
            }
        }
    });
}

// Reflectance of a film on a base of complex index (B,) at cosines (n,), into out (n, B); `phase` is
// 2 pi thickness / wavelength, `film` at least 1.
void reflect_film(Vector<const double> cos_theta, Vector<const double> phase, Vector<const double> film,
                  Vector<const double> eta, Vector<const double> k, Matrix<double> out) {
    using Complex = std::complex<double>;
    const size_t n = cos_theta.size(), B = film.size();
    require(phase.size() == B && eta.size() == B && k.size() == B && out.shape(0) == n && out.shape(1) == B,
            "expected cosines (n,), phases and indices (B,) and room for (n, B) values");
    for (size_t i = 0; i < n; ++i) {
        const double c0 = cosine_of(cos_theta.data()[i]), s2 = 1.0 - c0 * c0;
        for (size_t b = 0; b < B; ++b) {
            const Complex base(eta.data()[b], k.data()[b]), e2 = base * base;
            const double e1 = film.data()[b] * film.data()[b];
            // q is index times cosine of refraction, with the decaying branch (imaginary part >= 0).
            const double q1 = std::sqrt(std::max(e1 - s2, 0.0));
            Complex q2 = std::sqrt(e2 - s2);
            if (q2.imag() < 0.0) q2 = -q2;
            const Complex turn = std::polar(1.0, 2.0 * phase.data()[b] * q1);
            const double s01 = c0 + q1 > 0.0 ? (c0 - q1) / (c0 + q1) : -1.0;
            const double p01 = c0 + q1 > 0.0 ? (e1 * c0 - q1) / (e1 * c0 + q1) : -1.0;
            const Complex s12 = (q1 - q2) / (q1 + q2) * turn, p12 = (e2 * q1 - e1 * q2) / (e2 * q1 + e1 * q2) * turn;
            const Complex rs = (s01 + s12) / (1.0 + s01 * s12), rp = (p01 + p12) / (1.0 + p01 * p12);
            out.data()[i * B + b] = std::min(0.5 * (std::norm(rs) + std::norm(rp)), 1.0);
        }
    }
}

} // namespace

void bind_surfaces(nb::module_ &m) {
    m.def("project_facets", &project_facets, "w"_a, "m"_a, "area"_a, "out"_a.noconvert(), Unlocked());
    m.def("add_shift", &add_shift, "spectra"_a, "measured"_a, "ahead"_a, "behind"_a, "out"_a.noconvert(), Unlocked());
    m.def("valley_depths", &valley_depths, "f"_a, "dark"_a, "depth"_a.noconvert(), Unlocked());
    m.def("dequantise", &dequantise, "coefficients"_a, "basis"_a, "least"_a, "values"_a.noconvert(), Unlocked());
    m.def("integrate_caps", &integrate_caps, "stretched"_a, "alpha_x"_a, "alpha_y"_a, "heights"_a, "weights"_a,
          "cos_phi"_a, "sin_phi"_a, "out"_a.noconvert(), Unlocked());
    m.def("reflect_conductor", &reflect_conductor, "cos_theta"_a, "eta"_a, "k"_a, "parallel"_a.noconvert(),
          "perpendicular"_a.noconvert(), Unlocked());
    m.def("reflect_film", &reflect_film, "cos_theta"_a, "phase"_a, "film"_a, "eta"_a, "k"_a, "out"_a.noconvert(),
          Unlocked());
}
