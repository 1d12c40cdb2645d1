// The extension module `manifold.core._compiled`; `manifold/core/_compiled.pyi` documents what it has.

#include "kernels.hpp"

NB_MODULE(_compiled, m) {
    bind_evaluation(m);
    bind_models(m);
    bind_surfaces(m);
}
