/* What a program needs of the machine that it runs on. */
#ifndef BOARD_H
#define BOARD_H

#include <stdint.h>

struct spent { uint32_t instructions, stack; }; /* stack in bytes */

void begin(void);
struct spent end(void); /* since `begin`, in the same function; zeros on a host */
void put(char c);

#endif
