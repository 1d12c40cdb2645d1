// Loops of models: non-negative least squares, and moves of one latent of a likelihood.

#include <algorithm>
#include <limits>
#include <vector>

#include "common.hpp"
#include "kernels.hpp"

using namespace nanobind::literals;

namespace {

// Solve A x = y in place by Gaussian elimination with partial pivoting; A (n, n) is destroyed, y becomes x.
INLINE void solve(double *A, double *y, int n) {
    for (int k = 0; k < n; ++k) {
        int pivot = k;
        for (int i = k + 1; i < n; ++i)
            if (std::abs(A[i * n + k]) > std::abs(A[pivot * n + k])) pivot = i;
        if (pivot != k) {
            std::swap_ranges(A + k * n + k, A + k * n + n, A + pivot * n + k);
            std::swap(y[k], y[pivot]);
        }
        const double inverse = 1.0 / A[k * n + k];
        const double *RESTRICT upper = A + k * n;
        for (int i = k + 1; i < n; ++i) {
            double *RESTRICT row = A + i * n;
            const double factor = row[k] * inverse;
            for (int j = k + 1; j < n; ++j) row[j] -= factor * upper[j];
            y[i] -= factor * y[k];
        }
    }
    for (int k = n - 1; k >= 0; --k) {
        double sum = y[k];
        for (int j = k + 1; j < n; ++j) sum -= A[k * n + j] * y[j];
        y[k] = sum / A[k * n + k];
    }
}

// The active set of one problem after the other: inner products of n atoms, and which of them are used.
struct ActiveSet {
    const double *gram; // (n, n), its diagonal 1
    int n, count = 0;   // of atoms, and of those used
    std::vector<int> used;
    std::vector<double> A, solution, slope;
    std::vector<char> refused;

    ActiveSet(const double *gram, int n) : gram(gram), n(n), used(n), A(size_t(n) * n), solution(n), slope(n), refused(n) {}

    // Least squares on the atoms used, signs free.
    INLINE void solve_on_used(const double *cross) {
        for (int a = 0; a < count; ++a) {
            solution[a] = cross[used[a]];
            for (int b = 0; b < count; ++b) A[a * count + b] = gram[ptrdiff_t(used[a]) * n + used[b]];
        }
        solve(A.data(), solution.data(), count);
    }

    // Drop atoms of negative weight until the solution on those used is feasible.
    INLINE void warm_start(const double *cross, double *weights) {
        while (count > 0) {
            solve_on_used(cross);
            int kept = 0;
            for (int a = 0; a < count; ++a)
                if (solution[a] > 0.0) used[kept++] = used[a];
            if (kept == count) {
                for (int a = 0; a < count; ++a) weights[used[a]] = solution[a];
                return;
            }
            count = kept;
        }
    }

    // The unused atom of steepest slope above the limit, or -1.
    INLINE int steepest(const double *cross, const double *weights, double limit) {
        std::copy_n(cross, n, slope.begin());
        for (int a = 0; a < count; ++a) {
            const double w = weights[used[a]];
            const double *RESTRICT row = gram + ptrdiff_t(used[a]) * n;
            double *RESTRICT s = slope.data();
            for (int k = 0; k < n; ++k) s[k] -= w * row[k];
            slope[used[a]] = -std::numeric_limits<double>::infinity();
        }
        int enter = -1;
        for (int k = 0; k < n; ++k)
            if (slope[k] > limit && !refused[k]) enter = k, limit = slope[k];
        return enter;
    }

    // Go towards the solution until the first weight is zero, and drop it.
    INLINE void step_back(double *weights) {
        double step = 1.0;
        int first = -1;
        for (int a = 0; a < count; ++a) {
            if (solution[a] > 0.0) continue;
            const double w = weights[used[a]], share = w / std::max(w - solution[a], 1e-300);
            if (first < 0 || share < step) step = share, first = a;
        }
        int kept = 0;
        for (int a = 0; a < count; ++a) {
            const int k = used[a];
            weights[k] += step * (solution[a] - weights[k]);
            if (a == first || weights[k] <= 0.0)
                weights[k] = 0.0;
            else
                used[kept++] = k;
        }
        count = kept;
    }

    INLINE bool is_feasible() const {
        return std::all_of(solution.begin(), solution.begin() + count, [](double s) { return s > 0.0; });
    }

    // Add the atom of steepest slope until none reduces the residual, from a feasible solution on those used.
    INLINE void optimise(const double *cross, double *weights, double tolerance) {
        double largest = 0.0;
        for (int k = 0; k < n; ++k) largest = std::max(largest, std::abs(cross[k]));
        std::fill(refused.begin(), refused.end(), 0);
        for (int turn = 0; turn < 5 * n; ++turn) {
            const int enter = steepest(cross, weights, tolerance * largest);
            if (enter < 0) return;
            used[count++] = enter;
            solve_on_used(cross);
            if (solution[count - 1] <= 0.0) { // its slope was rounding
                refused[enter] = 1;
                --count;
                continue;
            }
            while (count > 0 && !is_feasible()) {
                step_back(weights);
                if (count > 0) solve_on_used(cross);
            }
            for (int a = 0; a < count; ++a) weights[used[a]] = solution[a];
        }
    }
};

// Weights (R, n) >= 0 that minimise v gram v - 2 v cross_r for every row r; `manifold.gp.nonnegative`.
void solve_nonnegative(Matrix<const double> gram, Matrix<const double> cross, double tolerance, Matrix<double> out) {
    const int n = int(gram.shape(0)), rows = int(cross.shape(0));
    require(gram.shape(1) == gram.shape(0) && cross.shape(1) == gram.shape(0) && out.shape(0) == cross.shape(0) &&
                out.shape(1) == cross.shape(1),
            "expected inner products (n, n) and (R, n), and room for (R, n) weights");
    ActiveSet active(gram.data(), n);
    fastest([&]() INLINE_LAMBDA {
        for (int r = 0; r < rows; ++r) {
            double *weights = out.data() + ptrdiff_t(r) * n;
            const double *products = cross.data() + ptrdiff_t(r) * n;
            std::fill_n(weights, n, 0.0);
            active.warm_start(products, weights);
            active.optimise(products, weights, tolerance);
            active.count = 0;
            for (int k = 0; k < n; ++k)
                if (weights[k] > 0.0) active.used[active.count++] = k;
        }
    });
}

// g of one squared distance in length scales: `Kernel.radial` by the index of `Kernel.numbers`.
INLINE double radial_of_pair(int family, double squared) {
    if (family == 0) return std::exp(-0.5 * squared);
    const double a = std::sqrt((family == 1 ? 3.0 : 5.0) * squared);
    return (family == 1 ? 1.0 + a : 1.0 + a + a * a / 3.0) * std::exp(-a);
}

// The point of a search and what follows from it, as `manifold.gp.likelihood.IncrementalObjective` keeps them: latents
// X (N, Q), their covariance K, P = K^-1 and the data's S, (N, N) each.
struct Search {
    double *X, *K, *P;
    const double *S;
    double *d, *Pd, *SPd, *Sp; // d, P d, S P d, S P e_i, shape (N,) each
    double *state;             // log|K|, tr(P S), ||X||^2, F, moves since P was computed
    ptrdiff_t N, Q;
    int family;
    double inverse_l2, n_outputs, prior;

    struct Move {
        double t, a, b, c, log_det, trace, squared_norm, value;
    };

    // Latent i moved by delta along axis q. Leaves d, P d and S P d, and S P e_i, which moves of the same latent share
    // (`is_cached`).
    INLINE Move try_move(ptrdiff_t i, ptrdiff_t q, double delta, bool is_cached) const {
        const double infinity = std::numeric_limits<double>::infinity();
        for (ptrdiff_t j = 0; j < N; ++j) {
            double squared = 0.0;
            for (ptrdiff_t k = 0; k < Q; ++k) {
                const double moved = k == q ? X[i * Q + k] + delta : X[i * Q + k];
                squared += (moved - X[j * Q + k]) * (moved - X[j * Q + k]);
            }
            d[j] = radial_of_pair(family, squared * inverse_l2) - K[i * N + j];
        }
        d[i] = 0.0;
        multiply(P, d, Pd);
        multiply(S, Pd, SPd);
        if (!is_cached) multiply(S, P + i * N, Sp);
        Move m{0.0, P[i * N + i], Pd[i], 0.0, 0.0, 0.0, 0.0, infinity};
        double pSp = 0.0, pSq = 0.0, qSq = 0.0;
        for (ptrdiff_t j = 0; j < N; ++j) {
            m.c += d[j] * Pd[j];
            pSp += P[i * N + j] * Sp[j];
            pSq += Pd[j] * Sp[j];
            qSq += Pd[j] * SPd[j];
        }
        m.t = (1.0 + m.b) * (1.0 + m.b) - m.a * m.c;
        if (!(m.t > 0.0)) return m; // rounding: no real move makes K indefinite
        m.log_det = state[0] + std::log(m.t);
        m.trace = state[1] + (m.c * pSp - 2.0 * (1.0 + m.b) * pSq + m.a * qSq) / m.t;
        m.squared_norm = state[2] + delta * (2.0 * X[i * Q + q] + delta);
        if (!(m.trace > 0.0)) return m;
        m.value = 0.5 * (m.log_det + N * std::log(m.trace / (N * n_outputs)) + prior * m.squared_norm);
        return m;
    }

    // Make a move in place; whether rows i and another of K P - I show that P has drifted.
    INLINE bool make_move(ptrdiff_t i, ptrdiff_t q, double target, const Move &m, double largest_drift,
                          double most_moves) const {
        double *RESTRICT p = Sp; // S P e_i is of no use after the move
        X[i * Q + q] = target;
        state[0] = m.log_det, state[1] = m.trace, state[2] = m.squared_norm, state[3] = m.value;
        state[4] += 1.0;
        std::copy_n(P + i * N, N, p);
        for (ptrdiff_t j = 0; j < N; ++j) {
            const double along_p = (m.c * p[j] - (1.0 + m.b) * Pd[j]) / m.t;
            const double along_q = (m.a * Pd[j] - (1.0 + m.b) * p[j]) / m.t;
            double *RESTRICT row = P + j * N;
            const double *RESTRICT q_of = Pd;
            for (ptrdiff_t k = 0; k < N; ++k) row[k] += along_p * p[k] + along_q * q_of[k];
            K[i * N + j] += d[j];
            K[j * N + i] = K[i * N + j];
        }
        double drift = 0.0;
        for (const ptrdiff_t row : {i, ptrdiff_t(state[4]) % N}) {
            double *RESTRICT residual = SPd;
            multiply(P, K + row * N, residual);
            residual[row] -= 1.0;
            for (ptrdiff_t k = 0; k < N; ++k)
                if (!(std::abs(residual[k]) <= drift)) drift = std::abs(residual[k]); // NaN counts as drift
        }
        return !(drift < largest_drift) || state[4] >= most_moves;
    }

    // out = A v with symmetric A (N, N): rows serve as columns, and the inner loop runs along memory.
    INLINE void multiply(const double *A, const double *v, double *RESTRICT out) const {
        std::fill_n(out, N, 0.0);
        for (ptrdiff_t j = 0; j < N; ++j) {
            const double w = v[j];
            const double *RESTRICT row = A + j * N;
            for (ptrdiff_t k = 0; k < N; ++k) out[k] += w * row[k];
        }
    }
};

Search search_of(Matrix<double> &X, Matrix<double> &K, Matrix<double> &P, Matrix<const double> &S, Matrix<double> &work,
                 Vector<double> &state, int family, double inverse_l2, double n_outputs, double prior) {
    const size_t N = X.shape(0);
    for (const auto &size : {K.shape(0), K.shape(1), P.shape(0), P.shape(1), S.shape(0), S.shape(1), work.shape(1)})
        require(size == N, "expected matrices (N, N) for latents (N, Q)");
    require(N >= 1 && work.shape(0) == 4 && state.size() == 5, "expected work of shape (4, N) and a state of five");
    require(family >= 0 && family < 3, "expected a kernel of `radial_of_pair`");
    double *w = work.data();
    return {X.data(), K.data(), P.data(), S.data(), w, w + N, w + 2 * N, w + 3 * N, state.data(),
            ptrdiff_t(N), ptrdiff_t(X.shape(1)), family, inverse_l2, n_outputs, prior};
}

// Try coordinates both ways from `index` on and keep each improvement, until P has drifted or the budget is spent: the
// next index, moves tried, whether P has drifted.
nb::tuple explore(Matrix<double> X, Matrix<double> K, Matrix<double> P, Matrix<const double> S, Matrix<double> work,
                  Vector<double> state, int family, double inverse_l2, double n_outputs, double prior,
                  double largest_drift, double most_moves, Vector<const double> steps, Vector<double> heading,
                  Vector<const double> lower, Vector<const double> upper, ptrdiff_t index, ptrdiff_t budget) {
    const Search search = search_of(X, K, P, S, work, state, family, inverse_l2, n_outputs, prior);
    const ptrdiff_t count = search.N * search.Q;
    require(ptrdiff_t(steps.size()) == count && ptrdiff_t(heading.size()) == count && ptrdiff_t(lower.size()) == count &&
                ptrdiff_t(upper.size()) == count && index >= 0,
            "expected a step, a heading and limits for each coordinate");
    ptrdiff_t tried = 0;
    bool has_drifted = false, is_spent = false;
    const auto run = [&]() INLINE_LAMBDA {
        for (; index < count && !has_drifted; ++index) {
            const ptrdiff_t i = index / search.Q, q = index % search.Q, before = tried;
            const double here = search.X[index], towards = heading.data()[index];
            for (const double sense : {towards, -towards}) {
                const double lowest = lower.data()[index], highest = upper.data()[index];
                const double target = std::min(std::max(here + sense * steps.data()[index], lowest), highest);
                if (target == here) continue;
                if (tried == budget) {
                    is_spent = true;
                    return;
                }
                const Search::Move move = search.try_move(i, q, target - here, tried > before);
                ++tried;
                if (move.value < search.state[3]) {
                    heading.data()[index] = sense;
                    has_drifted = search.make_move(i, q, target, move, largest_drift, most_moves);
                    break;
                }
            }
        }
    };
    {
        nb::gil_scoped_release unlocked;
        fastest(run);
    }
    return nb::make_tuple(index, tried, has_drifted && !is_spent);
}

// Sums over all other samples j of w^-2 and of (x_i - x_j) w^-3, where w = 1 + |x_i - x_j|^2 / 3: similarities
// (N,) by Student's t distribution of 3 degrees of freedom, and their forces (Q, N), for positions X (Q, N). The inner
// loop is over i, so that it adds to arrays and not to one number, in an order that no processor changes.
void repel(Matrix<const double> X, Vector<double> similarity, Matrix<double> force) {
    const size_t Q = X.shape(0), N = X.shape(1);
    require(similarity.size() == N && force.shape(0) == Q && force.shape(1) == N,
            "expected positions (Q, N), and room for (N,) similarities and (Q, N) forces");
    std::fill_n(similarity.data(), N, 0.0);
    std::fill_n(force.data(), Q * N, 0.0);
    std::vector<double> squared(N);
    fastest([&]() INLINE_LAMBDA {
        double *RESTRICT s = squared.data();
        for (size_t j = 0; j < N; ++j) {
            std::fill_n(s, N, 1.0);
            for (size_t q = 0; q < Q; ++q) {
                const double *RESTRICT x = X.data() + q * N;
                const double at = x[j];
                for (size_t i = 0; i < N; ++i) s[i] += (x[i] - at) * (x[i] - at) * (1.0 / 3.0);
            }
            double *RESTRICT sum = similarity.data();
            const double of_others = sum[j];
            for (size_t i = 0; i < N; ++i) {
                const double near = 1.0 / s[i];
                sum[i] += near * near;
                s[i] = near * near * near;
            }
            sum[j] = of_others;
            for (size_t q = 0; q < Q; ++q) {
                const double *RESTRICT x = X.data() + q * N;
                double *RESTRICT to = force.data() + q * N;
                const double at = x[j];
                for (size_t i = 0; i < N; ++i) to[i] += (x[i] - at) * s[i];
            }
        }
    });
}

} // namespace

void bind_models(nb::module_ &m) {
    m.def("repel", &repel, "X"_a, "similarity"_a.noconvert(), "force"_a.noconvert(), Unlocked());
    m.def("solve_nonnegative", &solve_nonnegative, "gram"_a, "cross"_a, "tolerance"_a, "out"_a.noconvert(), Unlocked());
    m.def("explore", &explore, "X"_a.noconvert(), "K"_a.noconvert(), "P"_a.noconvert(), "S"_a, "work"_a.noconvert(),
          "state"_a.noconvert(), "family"_a, "inverse_l2"_a, "n_outputs"_a, "prior"_a, "largest_drift"_a,
          "most_moves"_a, "steps"_a, "heading"_a.noconvert(), "lower"_a, "upper"_a, "index"_a, "budget"_a);
}
