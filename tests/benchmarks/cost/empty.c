/* A program that does nothing: what it takes belongs to no robot. */
int main(void) { return 0; }
