// Pairs of directions in tiles, and their coordinates in the unit square of RGL files.
//
// Loops run over whole tiles, whose length the compiler knows, so that they are vectorised; what lies behind the last
// pair of a call is the normal.
#pragma once

#include "common.hpp"

constexpr double LEVEL = 1e-9;         // cosine of a direction at the horizon; `manifold.core.pairs.LEVEL`
constexpr double LENGTH_ERROR = 2e-3;  // of squares of unit vectors; `manifold.core.directions.require_directions`
constexpr int TILE = 32;               // direction pairs that are handled together

// atan2 without branches or calls; within two units in the last place.
// Source: the rational approximation of Moshier's Cephes library, `atan`.
INLINE double arc_tangent(double y, double x) {
    const double ax = std::abs(x), ay = std::abs(y);
    const double most = ax > ay ? ax : ay, least = ax > ay ? ay : ax;
    const bool is_steep = least > 0.66 * most;
    const double above = is_steep ? least - most : least;
    double below = is_steep ? least + most : most;
    below = below > 0.0 ? below : 1.0;
    const double t = above / below, z = t * t;
    const double p = (((-8.750608600031904122785e-1 * z - 1.615753718733365076637e1) * z - 7.500855792314704667340e1) * z -
                      1.228866684490136173410e2) * z - 6.485021904942025371773e1;
    const double q = ((((z + 2.485846490142306297962e1) * z + 1.650270098316988542046e2) * z +
                       4.328810604912902668951e2) * z + 4.853903996359136964868e2) * z + 1.945506571482613964425e2;
    double angle = t + t * (z * p / q);
    angle = is_steep ? 0.25 * PI + angle : angle;
    angle = ay > ax ? 0.5 * PI - angle : angle;
    angle = x < 0.0 ? PI - angle : angle;
    return std::copysign(angle, y);
}

// Sine and cosine of `turns` quarter turns, within two units in the last place.
// Source: the polynomials of Moshier's Cephes library, `sin`.
INLINE void sine_cosine(double turns, double &sine, double &cosine) {
    const double nearest = std::floor(turns + 0.5), x = (turns - nearest) * (0.5 * PI), z = x * x;
    const double s = x + x * z * (((((1.58962301576546568060e-10 * z - 2.50507477628578072866e-8) * z +
                                     2.75573136213857245213e-6) * z - 1.98412698295895385996e-4) * z +
                                   8.33333333332211858878e-3) * z - 1.66666666666666307295e-1);
    const double c = 1.0 - 0.5 * z + z * z * (((((-1.13585365213876817300e-11 * z + 2.08757008419747316778e-9) * z -
                                                 2.75573141792967388112e-7) * z + 2.48015872888517045348e-5) * z -
                                               1.38888888888730564116e-3) * z + 4.16666666666665929218e-2);
    const double quarter = nearest - 4.0 * std::floor(0.25 * nearest); // 0, 1, 2 or 3
    const bool is_odd = (quarter == 1.0) | (quarter == 3.0);
    const double of_sine = is_odd ? c : s, of_cosine = is_odd ? s : c;
    sine = quarter >= 2.0 ? -of_sine : of_sine;
    cosine = (quarter == 1.0) | (quarter == 2.0) ? -of_cosine : of_cosine;
}

INLINE double theta_to_u(double theta) { return std::sqrt(theta * (2.0 / PI)); }

INLINE double phi_to_u(double phi) { return (phi + PI) / (2.0 * PI); }

// Rows of directions (K, 3) in single or double precision; one row may stand for all.
struct Rows {
    const void *data;
    bool is_single;
    ptrdiff_t step; // from row to row, in numbers
};

// Directions of a tile.
struct Directions {
    double x[TILE], y[TILE], z[TILE];

    template <class T> INLINE void copy(const T *from, ptrdiff_t step, int n) {
        for (int k = 0; k < n; ++k, from += step) x[k] = from[0], y[k] = from[1], z[k] = from[2];
        for (int k = n; k < TILE; ++k) x[k] = y[k] = 0.0, z[k] = 1.0;
    }

    // Copy n rows, and return whether all are unit vectors.
    INLINE bool load(const Rows &rows, ptrdiff_t start, int n) {
        if (rows.is_single)
            copy(static_cast<const float *>(rows.data) + start * rows.step, rows.step, n);
        else
            copy(static_cast<const double *>(rows.data) + start * rows.step, rows.step, n);
        double wrong = 0.0;
        for (int k = 0; k < TILE; ++k)
            wrong += std::abs(x[k] * x[k] + y[k] * y[k] + z[k] * z[k] - 1.0) <= LENGTH_ERROR ? 0.0 : 1.0;
        return wrong == 0.0;
    }
};

// Load n rows of points of the unit square into a tile.
INLINE void load_points(const Rows &rows, ptrdiff_t start, int n, double *x, double *y) {
    for (int k = 0; k < n; ++k) {
        const ptrdiff_t at = (start + k) * rows.step;
        x[k] = rows.is_single ? static_cast<const float *>(rows.data)[at] : static_cast<const double *>(rows.data)[at];
        y[k] = rows.is_single ? static_cast<const float *>(rows.data)[at + 1] : static_cast<const double *>(rows.data)[at + 1];
    }
    for (int k = n; k < TILE; ++k) x[k] = y[k] = 0.5;
}

// Of a file: whether it depends on differences of azimuths only, and how often azimuths repeat in a turn.
struct Symmetry {
    bool is_isotropic;
    int repeats;
};

// Incident directions of a tile as a file sees them, and their angles; azimuths are 0 where nothing depends on them.
struct Incident {
    Directions w;
    double sx[TILE], sy[TILE], theta[TILE], phi[TILE];

    INLINE Incident(const Directions &wi, Symmetry symmetry, bool needs_azimuth) {
        for (int k = 0; k < TILE; ++k) sx[k] = sy[k] = 1.0;
        if (symmetry.repeats > 1) // move directions into the measured range of azimuths
            for (int k = 0; k < TILE; ++k) {
                sy[k] = wi.y[k] >= 0.0 ? -1.0 : 1.0;
                sx[k] = (symmetry.repeats == 4 ? wi.x[k] : wi.y[k]) >= 0.0 ? -1.0 : 1.0;
            }
        for (int k = 0; k < TILE; ++k) w.x[k] = wi.x[k] * sx[k], w.y[k] = wi.y[k] * sy[k], w.z[k] = wi.z[k];
        for (int k = 0; k < TILE; ++k) {
            theta[k] = arc_tangent(std::sqrt(w.x[k] * w.x[k] + w.y[k] * w.y[k]), w.z[k]); // stable near the normal
            phi[k] = 0.0;
        }
        if (needs_azimuth)
            for (int k = 0; k < TILE; ++k) phi[k] = arc_tangent(w.y[k], w.x[k]);
    }

    // The direction from which azimuths of half vectors count, of any length.
    INLINE void reference(int k, Symmetry symmetry, double &x, double &y) const {
        const double relative = symmetry.is_isotropic ? 1.0 : 0.0;
        x = relative * w.x[k], y = relative * w.y[k];
        x = (x == 0.0) & (y == 0.0) ? 1.0 : x;
    }
};

// Pairs of a tile in the tables of a file: angles of incident directions, half vectors in the unit square, and cosines of
// outgoing directions, 0 of pairs that are not above the horizon.
struct Located {
    double theta_i[TILE], phi_i[TILE], x[TILE], y[TILE], cos_o[TILE];

    INLINE void locate(const Directions &wi, const Directions &wo, Symmetry symmetry, bool needs_azimuth) {
        const Incident i(wi, symmetry, needs_azimuth);
        for (int k = 0; k < TILE; ++k) {
            theta_i[k] = i.theta[k], phi_i[k] = i.phi[k];
            const double mx = i.w.x[k] + wo.x[k] * i.sx[k], my = i.w.y[k] + wo.y[k] * i.sy[k], mz = i.w.z[k] + wo.z[k];
            double ax, ay;
            i.reference(k, symmetry, ax, ay);
            const double v = phi_to_u(arc_tangent(ax * my - ay * mx, ax * mx + ay * my));
            x[k] = theta_to_u(arc_tangent(std::sqrt(mx * mx + my * my), mz));
            y[k] = v - std::floor(v);
            cos_o[k] = (wi.z[k] > LEVEL) & (wo.z[k] > LEVEL) ? wo.z[k] : 0.0;
        }
    }

    // Copy n rows of `Pairs.located`.
    INLINE void copy(const double *rows, int n) {
        for (int k = 0; k < n; ++k, rows += 5)
            theta_i[k] = rows[0], phi_i[k] = rows[1], x[k] = rows[2], y[k] = rows[3], cos_o[k] = rows[4];
        for (int k = n; k < TILE; ++k) theta_i[k] = phi_i[k] = x[k] = y[k] = cos_o[k] = 0.0;
    }
};

// Normals of a tile at points of the unit square, and their cosines with incident directions.
struct Normals {
    double x[TILE], y[TILE], z[TILE], sine[TILE], cos_im[TILE];

    INLINE Normals(const double *ux, const double *uy, const Incident &i, Symmetry symmetry) {
        for (int k = 0; k < TILE; ++k) {
            double ax, ay, sin_phi, cos_phi;
            i.reference(k, symmetry, ax, ay);
            const double length = std::sqrt(ax * ax + ay * ay);
            sine_cosine(ux[k] * ux[k], sine[k], z[k]);
            sine_cosine(4.0 * uy[k] - 2.0, sin_phi, cos_phi);
            x[k] = sine[k] * (cos_phi * ax - sin_phi * ay) / length;
            y[k] = sine[k] * (cos_phi * ay + sin_phi * ax) / length;
            cos_im[k] = i.w.x[k] * x[k] + i.w.y[k] * y[k] + i.w.z[k] * z[k];
        }
    }
};

// Solid angle of outgoing directions per area of the half vector's unit square.
INLINE double half_vector_jacobian(double ux, double sin_m, double cos_im) {
    const double area = 2.0 * PI * PI * ux * sin_m;
    return (area > 1e-6 ? area : 1e-6) * 4.0 * cos_im;
}
