/* A program that runs into a fault at once: the port has to end it, with a failure, instead of hanging. */
int main(void) { __builtin_trap(); }
