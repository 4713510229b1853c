/* A computer with an operating system: results only. */
#include <stdio.h>

#include "board.h"

void begin(void) {}

struct spent end(void) { return (struct spent){0, 0}; }

void put(char c) { putchar(c); }
