#include "vo_core/pyramid.h"
