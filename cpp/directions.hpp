// Angles of directions and coordinates in the unit square of RGL files.
#pragma once

#include "common.hpp"

constexpr double LEVEL = 1e-9; // cosine of a direction at the horizon; `manifold.core.pairs.LEVEL`

// atan2 without branches or calls, so that loops over it are vectorised; within two units in the last place.
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

// Angle from the normal, stable near it.
INLINE double elevation(double x, double y, double z) { return arc_tangent(std::sqrt(x * x + y * y), z); }

INLINE double theta_to_u(double theta) { return std::sqrt(theta * (2.0 / PI)); }

INLINE double phi_to_u(double phi) { return (phi + PI) / (2.0 * PI); }

// Signs that move an incident direction into the measured range of azimuths of a symmetric file.
INLINE void signs(int reduction, double wx, double wy, double &sx, double &sy) {
    sx = sy = 1.0;
    if (reduction < 2) return;
    sy = wy >= 0.0 ? -1.0 : 1.0;
    sx = reduction == 4 ? (wx >= 0.0 ? -1.0 : 1.0) : sy;
}

// The incident direction as a symmetric file sees it.
struct Incident {
    double sx, sy, x, y, z, theta, phi;

    INLINE Incident(const double *w, int reduction) {
        signs(reduction, w[0], w[1], sx, sy);
        x = w[0] * sx, y = w[1] * sy, z = w[2];
        theta = elevation(x, y, z), phi = arc_tangent(y, x);
    }
};

// The half vector of a point of the unit square, and its elevation.
struct HalfVector {
    double x, y, z, theta;

    INLINE HalfVector(double ux, double uy, double phi_i, bool isotropic) {
        theta = ux * ux * (0.5 * PI);
        const double phi = (2.0 * uy - 1.0) * PI + (isotropic ? phi_i : 0.0), sine = std::sin(theta);
        x = std::cos(phi) * sine, y = std::sin(phi) * sine, z = std::cos(theta);
    }

    INLINE double dot(const Incident &w) const { return w.x * x + w.y * y + w.z * z; }
};

// Solid angle of outgoing directions per area of the half vector's unit square.
INLINE double half_vector_jacobian(double ux, double theta_m, double cos_im) {
    const double area = 2.0 * PI * PI * ux * std::sin(theta_m);
    return (area > 1e-6 ? area : 1e-6) * 4.0 * cos_im;
}

constexpr int TILE = 32; // direction pairs that are located together

// Direction pairs as a file sees them: angles of the incident direction, coordinates of the half vector in the unit
// square, and the cosine of the outgoing direction, 0 of pairs that are not above the horizon.
struct Located {
    double theta_i[TILE], phi_i[TILE], x[TILE], y[TILE], cos_o[TILE];
};

// Locate n <= TILE pairs of directions (n, 3).
INLINE void locate(const double *wi, const double *wo, int n, bool isotropic, int reduction, Located &out) {
    double ix[TILE], iy[TILE], iz[TILE], ox[TILE], oy[TILE], oz[TILE];
    for (int k = 0; k < n; ++k) {
        double sx, sy;
        signs(reduction, wi[3 * k], wi[3 * k + 1], sx, sy);
        ix[k] = wi[3 * k] * sx, iy[k] = wi[3 * k + 1] * sy, iz[k] = wi[3 * k + 2];
        ox[k] = wo[3 * k] * sx, oy[k] = wo[3 * k + 1] * sy, oz[k] = wo[3 * k + 2];
    }
    for (int k = n; k < TILE; ++k) ix[k] = iy[k] = iz[k] = ox[k] = oy[k] = oz[k] = 0.0;
    const double relative = isotropic ? 1.0 : 0.0;
    for (int k = 0; k < TILE; ++k) {
        const double mx = ix[k] + ox[k], my = iy[k] + oy[k], mz = iz[k] + oz[k];
        const double phi_i = arc_tangent(iy[k], ix[k]), phi_m = arc_tangent(my, mx);
        const double y = phi_to_u(phi_m - relative * phi_i);
        out.theta_i[k] = elevation(ix[k], iy[k], iz[k]);
        out.phi_i[k] = phi_i;
        out.x[k] = theta_to_u(elevation(mx, my, mz));
        out.y[k] = y - std::floor(y);
        out.cos_o[k] = (iz[k] > LEVEL) & (oz[k] > LEVEL) ? oz[k] : 0.0;
    }
}
