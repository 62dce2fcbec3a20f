// What the statements of a lane use, as CUDA or, to be tried on any machine, as C++.
#ifdef __CUDACC__
#define LANES extern "C" __global__ void __launch_bounds__(THREADS)
#define ONE_LANE __device__ __forceinline__
#define TABLE __device__ const
#define NOT_A_NUMBER __longlong_as_double(0x7ff8000000000000LL)
#define INFINITE __longlong_as_double(0x7ff0000000000000LL)
#define EACH_LANE(count) \
  const long long lane = blockIdx.x * (long long)blockDim.x + threadIdx.x; \
  if (lane < (count))
#else
#include <cmath>
using namespace std;
#define LANES extern "C" void
#define ONE_LANE static inline
#define TABLE static const
#define NOT_A_NUMBER __builtin_nan("")
#define INFINITE __builtin_huge_val()
#define EACH_LANE(count) for (long long lane = 0; lane < (count); ++lane)
static inline double rsqrt(double x) { return 1.0 / sqrt(x); }
#endif

// NaN wins, as in XLA.
template <class T> ONE_LANE T larger(T x, T y) { return x != x ? x : y != y ? y : x > y ? x : y; }
template <class T> ONE_LANE T smaller(T x, T y) { return x != x ? x : y != y ? y : x < y ? x : y; }
template <class T> ONE_LANE bool beats_below(T x, T best) { return best == best && (x != x || x < best); }
template <class T> ONE_LANE bool beats_above(T x, T best) { return best == best && (x != x || x > best); }
template <class T> ONE_LANE T sign_of(T x) { return x != x ? x : (T)(x > (T)0) - (T)(x < (T)0); }
template <class T> ONE_LANE T remainder_of(T x, T y) { return x % y; }
ONE_LANE double remainder_of(double x, double y) { return fmod(x, y); }
ONE_LANE float remainder_of(float x, float y) { return fmodf(x, y); }
template <class T> ONE_LANE bool is_finite(T x) { return x - x == x - x; }
template <class T> ONE_LANE T logistic(T x) { return (T)1 / ((T)1 + exp(-x)); }
template <int N, class T> ONE_LANE T power(T x) {
  T result = (T)1, square = x;
  bool begun = false;
#pragma unroll
  for (int n = N; n; n >>= 1) {
    if (n & 1) { result = begun ? result * square : square; begun = true; }
    square = square * square;
  }
  return result;
}
template <class T> ONE_LANE int within(T place, int most) { return place < 0 ? 0 : place > most ? most : (int)place; }
template <class To, class From> ONE_LANE To bits_as(From x) {
  union { From from; To to; } bits;
  bits.from = x;
  return bits.to;
}
