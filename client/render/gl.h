#pragma once

// OpenGL 3.3 core. libOSMesa exports every entry point itself, so no loader is needed.
#define GL_GLEXT_PROTOTYPES
#include <GL/glcorearb.h>
