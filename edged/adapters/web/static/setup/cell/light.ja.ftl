# Texts of light.js.
light-title = 照明とピント
light-what = エッジを鮮明にし、飽和をなくします。まず照明、次にレンズのリングを、精度への影響を見ながら調整します。
light-thing = まずワークの置かれる場所にボードかワークを置いてください。照明とピントはそれで判断します。何もないと誤った助言になります。
light-thing-is = 置きました
light-thing-there = 照明とピントは、そこにあるもので判断されます。
light-thing-gone = もう何もありません
light-take = 露光時間とゲインの設定にはカメラが必要です。セルを取得してください。
light-no-settings = ここで設定できるものはありません。カメラが範囲を返さないか、接続されていません。
light-no-figures = 数値はライブ画像とともに表示されます。
settings-left = 左カメラの設定
settings-right = 右カメラの設定
setting-exposure-us = 露光時間
setting-gain-db = ゲイン
light-head = 照明
light-figures = 飽和 { $clipped } %、暗すぎ { $dark } %、ノイズ { $noise }、コントラスト { $contrast } 階調
advice-good = 露光は適正です。
advice-less-light = 飽和した部分は測定できません。露光を短くするか、照明を弱くしてください。
advice-more-light = 暗すぎます。露光を長くするか、照明を強くしてください。
advice-light-for-gain = ノイズが多めです。ゲインを下げ、露光を長くするか照明を強くしてください。
advice-take = { $exposure } µs に設定
legend-clipped = 飽和
legend-dark = 暗すぎ
light-copy = 右カメラも同じ設定にする
focus-title = ピント
focus-none = 判断するエッジがありません。ボードかワークを置いてください。
focus-now = エッジの幅 { $now } px
focus-best = 最良 { $best } px
focus-cost =
    { $isFree ->
        [0] Z の σ への影響はありません。
       *[other] Z の σ が { $percent } % 大きくなります。
    }
focus-reset = 最良値をリセット
