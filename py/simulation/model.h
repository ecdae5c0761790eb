/* A model as the driver takes it: sizes, tables and CasADi functions, from a library of its own.

     slopes  (t, x, u, p) -> x'                            (explicit steps only)
     output  (t, x, u, p) -> y
     rate    (t, x, u, p) -> x', df/dx, df/dp, df/du      (nonzeros only)
     seen    (t, x, u, p) -> y , dh/dx, dh/dp, dh/du

   Lists end with an entry that nobody reads, so that none is empty. */

typedef long long Integer; /* casadi_int */
typedef int Function(const double **arg, double **res, Integer *integers, double *work, int memory);

/* Row i: nonzeros at[n] in columns column[n], n from first[i] to first[i + 1]. */
typedef struct {
  int nonzeros;
  const int *first, *at, *column;
} Sparse;

typedef struct {
  Function *function;
  Sparse x, p, u; /* columns: rows of the seeds, free values, dead times */
} Linear;

typedef struct {
  int nx, ns, nu, np, ny, nt, ld; /* states, those with sensitivities, inputs, parameters, outputs, free values, even */
  int nd, nz;                     /* inputs whose dead time is free, parameters at zero */
  int cut, implicit;              /* whether pieces between samples may end at late inputs; how it steps */
  Integer arguments, results, reals, integers; /* what the functions need */
  const double *nominal, *nominal_free;        /* of states, of free values */
  const int *free, *delay, *linear, *kept, *zero, *dead_input, *dead_column;
  Function *slopes, *output;
  Linear rate, seen;
} Model;
