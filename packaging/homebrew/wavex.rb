# `packaging/release.sh` fills the checksum; `packaging/recipes.py check` compares the rest with Cargo.toml.
class Wavex < Formula
  desc "Full-waveform lidar to point clouds with standard deviations"
  # A placeholder, as in Cargo.toml.
  homepage "https://wavex.example"
  url "https://wavex.example/releases/0.1.0/wavex-0.1.0-source.tar.gz"
  sha256 "0000000000000000000000000000000000000000000000000000000000000000"
  license any_of: ["MIT", "Apache-2.0"]

  depends_on "rust" => :build

  def install
    system "cargo", "install", *std_cargo_args
    system bin/"wavex", "--quiet", "man", man1
    generate_completions_from_executable(bin/"wavex", "completions")
    pkgshare.install "jobs"
  end

  test do
    system bin/"wavex", "--quiet", "run", "--set", "job.output_dir=#{testpath}", pkgshare/"jobs/demo.toml"
    assert_path_exists testpath/"demo.laz"
  end
end
