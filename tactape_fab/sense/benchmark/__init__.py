"""A data set of simulated contacts with its truth in a second file, and a score for anybody's answers: docs/benchmark.md."""
