// f of OpenPBR by Adobe's openpbr-bsdf, for `openpbr_bsdf.py`: an opaque surface in vacuum, seen from outside.

#include <glm/glm.hpp>

#include "openpbr.h"

extern "C" void evaluate(const float* v, const float* pairs, int count, float* f)
{
    OpenPBR_ResolvedInputs inputs = openpbr_make_default_resolved_inputs();
    const auto colour = [&v] { const vec3 made(v[0], v[1], v[2]); v += 3; return made; };
    inputs.base_weight = *v++;
    inputs.base_color = colour();
    inputs.base_metalness = *v++;
    inputs.specular_weight = *v++;
    inputs.specular_color = colour();
    inputs.specular_roughness = *v++;
    inputs.specular_ior = *v++;
    inputs.specular_roughness_anisotropy = *v++;
    const float tangent = *v++;
    inputs.specular_anisotropy_rotation_cos_sin = vec2(std::cos(tangent), std::sin(tangent));
    inputs.coat_weight = *v++;
    inputs.coat_roughness = *v++;
    inputs.coat_ior = *v++;
    inputs.coat_darkening = *v++;
    inputs.fuzz_weight = *v++;
    inputs.fuzz_color = colour();
    inputs.fuzz_roughness = *v++;
    inputs.thin_film_weight = *v++;
    inputs.thin_film_thickness = *v++;
    inputs.thin_film_ior = *v++;
    for (int i = 0; i < count; ++i, pairs += 6, f += 3) {
        const vec3 view(pairs[0], pairs[1], pairs[2]), light(pairs[3], pairs[4], pairs[5]);
        const OpenPBR_PreparedBsdf bsdf = openpbr_prepare(
            inputs, vec3(1.0f), OpenPBR_BaseRgbWavelengths_nm, OpenPBR_VacuumIor, view);
        const vec3 value = openpbr_get_sum_of_diffuse_specular(openpbr_eval(bsdf, light)) / light.z;
        for (int channel = 0; channel < 3; ++channel)
            f[channel] = value[channel];
    }
}
