# Texts of welcome.js.
welcome-title = { $cell }：セットアップ
welcome-new = 開梱したカメラからワークをつかむまで 9 ステップ。チェックはクリックではなく、セルに備わったものを示します。
welcome-complete = セルには測定に必要なものがそろっています。各ステップは閲覧もやり直しもできます。
welcome-done = 不足はありません。
welcome-facts = セルに備わったもの
welcome-later = コマンドラインで行うもの
welcome-later-why = これらのステップはまだブラウザではできません。コマンドはマニュアルにあります。
next-cameras = 次：カメラ
next-light = 次：照明とピント
next-calibrate = 次：キャリブレーション
next-check = 次：点検
next-teach = 次：ワークのティーチング
next-try = 次：試行
next-robot = 次：ロボット
next-plc = 次：PLC と運転開始
fact-cameras = カメラ
fact-cameras-found =
    { $count ->
        [0] 見つかりません
       *[other] { $count } 台
    }{ $troubled ->
        [0] { "" }
       *[other] （うち { $troubled } 台に問題あり）
    }
fact-unknown = 未確認
fact-rig-sigma = （ティーチングした場所で ±{ $sigma } µm）
fact-no-rig = まだなし
fact-no-jobs = まだなし
fact-plc = PLC
fact-plc-owner = 書き込み元
fact-no-plc = 書き込みなし
fact-machine = この PC
fact-machine-new = まだ検査していません
fact-machine-found = 問題 { $bad } 件、要確認 { $warn } 件
fact-machine-look = 見る
fact-error = 異常
manual-cameras = カメラの設定方法
manual-light = カメラの設定方法
manual-calibrate = キャリブレーションの方法
manual-check = 検証の方法
manual-teach = ティーチングの方法
manual-try = 操作方法
manual-robot = ロボットの座標合わせの方法
manual-plc = PLC の接続方法
