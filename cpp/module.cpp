// The extension module `manifold._compiled`; `manifold/_compiled.pyi` documents what it has.

#include "kernels.hpp"

NB_MODULE(_compiled, m) {
    bind_evaluation(m);
    bind_models(m);
    bind_surfaces(m);
}
