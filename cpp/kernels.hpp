// What every file of this folder adds to the module.
#pragma once

#include <nanobind/nanobind.h>

void bind_evaluation(nanobind::module_ &m);
void bind_models(nanobind::module_ &m);
void bind_surfaces(nanobind::module_ &m);
