"""One file an analysis, one analysis a quantity: `registry` lists them, `options` has what each can be asked for."""
